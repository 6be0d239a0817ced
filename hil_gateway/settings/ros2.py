"""Settings of the bridge to ROS 2."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hil_gateway.process.model import Model


class Ros2Config(Model):
    """Bridge process; it has a Zenoh session of its own on the ROS side, apart from the gateway's bus."""

    mode: Literal["peer", "client", "router"] = Field(
        default="peer", description="router: takes the place of `rmw_zenohd`; the others reach one at `connect`"
    )
    connect: tuple[str, ...] = Field(default=("tcp/localhost:7447",), description="endpoint of `rmw_zenohd`")
    listen: tuple[str, ...] = Field(
        default=(), description="endpoints; empty: a free port of this computer, as a router that of `connect`"
    )
    extra: str = Field(default="", description="path of a Zenoh JSON5 file merged over these (TLS)")
    domain: int = Field(default=0, ge=0, le=232, description="ROS_DOMAIN_ID")
    type_hashes: bool = Field(default=True, description="false for Humble, which has none")
    messages: Literal["av24", "av21"] = Field(
        default="av24", description="generation of raptor_dbw_msgs and deep_orange_msgs"
    )
    commands: Literal["none", "raptor", "ackermann"] = Field(default="none", description="which commands are taken")
    frames: bool = Field(default=True, description="every CAN frame as can_msgs/Frame")
    clock_ahead_max_s: float = Field(
        default=0.005, ge=0, le=0.1, description="by which the sender's clock may lead: NTP in one network keeps 5 ms"
    )
