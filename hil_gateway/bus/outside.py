"""Messages of the processes that speak with a team's network: what receivers say, and how receivers and bridge do."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from hil_gateway.bus.messages import Count, Deviation, Heading, Message, Motion, Name, Parameter, Text
from hil_gateway.process.model import Model

Counts = Annotated[dict[Name, Count], Field(max_length=64)]


class Quality(StrEnum):
    """What a log of a receiver is good for."""

    FIXED = "fixed"
    DEGRADED = "degraded"
    REFUSED = "refused"


class Place(Model):
    """Of the antenna or the point that the receiver is set to, WGS 84; deviations in m, null where it states none."""

    latitude: float = Field(ge=-90, le=90, description="deg")
    longitude: float = Field(ge=-180, le=180, description="deg")
    height: Motion | None = Field(description="above the ellipsoid, m")
    std_east: Deviation | None
    std_north: Deviation | None
    std_up: Deviation | None


class Velocity(Model):
    """Of the same point over ground, m/s; its deviation null where the receiver states none."""

    east: Motion
    north: Motion
    up: Motion | None
    std: Deviation | None = Field(description="of east and north, the larger")


class Rates(Model):
    """Of a receiver's inertial unit, axes of the car, means since the log before: rad/s and specific force, m/s2."""

    roll_rate: Motion
    pitch_rate: Motion
    yaw_rate: Motion
    ax: Motion
    ay: Motion
    az: Motion
    std_rate: Deviation | None
    std_force: Deviation | None


class Navigation(Message):
    """One log of a receiver. `stamp_ns`: when it is of, by the monotonic clock of the computer that reads it."""

    source: Name = Field(description="receiver of the car folder")
    log: Name
    quality: Quality
    reason: Text = Field(default="", description="why it is not fixed")
    gps_ns: Count = Field(description="GPS time, ns since 1980-01-06, leap seconds not counted")
    late_s: Parameter = Field(description="from then to its arrival at this computer")
    places: bool = Field(default=False, description="of the logs of its receiver, it is the one that places the car")
    place: Place | None = None
    velocity: Velocity | None = None
    heading: Heading | None = None
    rates: Rates | None = None


class ReceiverHealth(Model):
    """One receiver."""

    connected: bool
    cause: Text = Field(description="why it does not place the car now; empty: it does")
    late_s: Parameter | None = Field(description="of its newest log, from the time that it is of to its arrival")
    clock_s: Parameter | None = Field(description="this computer's clock ahead of GPS time, with that delay in it")
    leap_s: Count = Field(description="GPS less UTC")
    logs: Count
    refused: Counts = Field(description="reason -> logs since start")
    damaged: Count = Field(description="logs and sentences with a wrong checksum since start")
    connections: Count


class ReceiverStatus(Message):
    """What receivers on the network do (1 Hz, and when a cause changes)."""

    receivers: Annotated[dict[Name, ReceiverHealth], Field(max_length=16)]


class Ros2Status(Message):
    """What the bridge to ROS 2 passes on and what it refuses (1 Hz)."""

    session: Name = Field(description="Zenoh identifier of the bridge on the ROS side")
    nodes: Count = Field(description="other nodes of the domain")
    sent: Count = Field(description="messages published for ROS since start")
    taken: Count = Field(description="command messages taken since start")
    refused: Counts = Field(description="reason -> command messages not taken since start")
    notes: tuple[Text, ...] = Field(max_length=16, description="what keeps nodes and bridge apart now, in words")
