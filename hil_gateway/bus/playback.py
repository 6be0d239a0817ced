"""Says that what is on the bus is a recording: nobody shall take a replay for a live car."""

from __future__ import annotations

from pydantic import Field

from hil_gateway.bus.messages import FilePath, Message


class Playback(Message):
    """A recording is being played (published by the player, which takes the gateway's place)."""

    file: FilePath = Field(description="name of the recording")
    position_s: float = Field(ge=0, description="of the recording, since its first message")
    speed: float = Field(ge=0, description="1: real time; 0: as fast as possible")
