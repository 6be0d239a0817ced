"""Health of the bridge to ROS 2."""

from __future__ import annotations

from pydantic import Field

from hil_gateway.bus.messages import Count, Message, Name, Text


class Ros2Status(Message):
    """What the bridge passes on and what it refuses (1 Hz)."""

    session: Name = Field(description="Zenoh identifier of the bridge on the ROS side")
    nodes: Count = Field(description="other nodes of the domain")
    sent: Count = Field(description="messages published for ROS since start")
    taken: Count = Field(description="command messages taken since start")
    refused: dict[Name, Count] = Field(max_length=64, description="reason -> command messages not taken since start")
    notes: tuple[Text, ...] = Field(max_length=16, description="what keeps nodes and bridge apart now, in words")
