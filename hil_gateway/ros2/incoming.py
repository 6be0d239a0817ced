"""Commands of ROS nodes as commands of the gateway, or why they are none. Pure.

Stamps: a command is as old as the time at which its node published it (attachment), an Ackermann command as the time in
its header where that is earlier and not 0: a node that copies the stamp of the odometry it answers is aged from the
measurement on. Raptor commands come in three messages; together they are as old as the oldest. The sender's clock may
lead by `clock_ahead_max_s`. From there on the gateway treats them as its planner's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hil_gateway.bus.messages import Command, VehicleState
from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.config import Config
from hil_gateway.gateway.command_gate import SOURCE_TIMEOUT_S
from hil_gateway.gateway.perceive.road_speed import road_speed
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.graph import NAMES_MAX
from hil_gateway.ros2.session import ReceivedSample
from hil_gateway.ros2.types import Types
from hil_gateway.ros2.wire import Attachment

SPEED_TIME_S = 0.5
"""time constant with which an Ackermann command's speed is approached"""
Name = Callable[[bytes], str]
"""identifier of a publisher -> name of its node"""


@dataclass(slots=True)
class _Newest:
    """What holds on one topic."""

    message: Any
    gid: bytes
    sequence: int
    stamp_ns: int
    received_ns: int


@dataclass(slots=True)
class Incoming:
    """Takes messages of the command topics; `command` is what they come to."""

    config: Config
    types: Types
    session: str
    name: Name
    taken: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    _newest: dict[str, _Newest] = field(default_factory=dict)
    _seq: int = 0

    def take(self, received: ReceivedSample, now_ns: int, unix_offset_ns: int) -> str:
        """Why it is not taken; empty where it is."""
        reason = self._offer(received, now_ns, unix_offset_ns)
        if reason:
            self.refused[reason] = self.refused.get(reason, 0) + 1
        else:
            self.taken += 1
        return reason

    def command(self, now_ns: int, state: VehicleState | None) -> Command | None:
        """Command of the newest messages; None until every topic it needs has one, or without a vehicle state."""
        needed = NEEDED[self.config.ros2.commands]
        if state is None or any(topic not in self._newest for topic in needed):
            return None
        steer, drive = self._raptor(state) if len(needed) > 1 else self._ackermann(state)
        self._seq += 1
        return Command(
            stamp_ns=now_ns,
            seq=self._seq - 1,
            source=self._source(needed[0]),
            state_stamp_ns=min(self._newest[topic].stamp_ns for topic in needed),
            steer=steer,
            drive=drive,
        )

    def _source(self, topic: str) -> str:
        """Name of the sender, with the bridge it comes through: two bridges are two sources."""
        node = self.name(self._newest[topic].gid) or "unnamed node"
        return f"ros2 {self.session[:4]} {node}"[:NAMES_MAX]

    def _offer(self, received: ReceivedSample, now_ns: int, unix_offset_ns: int) -> str:
        attachment, topic = received.attachment, received.topic.name
        if attachment is None:
            return "attachment is not that of rmw_zenoh (Jazzy before 0.2.4?)"
        message = self.types.from_bytes(received.topic.type, received.data)
        if message is None or not _usable(received.topic.type, message):
            return f"{topic} is no {received.topic.type} within its bounds"
        if disorder := self._disorder(topic, attachment, now_ns):
            return disorder
        stamp_ns = _unix_stamp(message, attachment.source_ns) - unix_offset_ns
        if stamp_ns > now_ns + self.config.ros2.clock_ahead_max_s * NS_PER_S:
            return "the clock of the sender is ahead"
        stamp_ns = max(min(stamp_ns, now_ns), 0)
        self._newest[topic] = _Newest(message, attachment.gid, attachment.sequence, stamp_ns, now_ns)
        return ""

    def _disorder(self, topic: str, attachment: Attachment, now_ns: int) -> str:
        known = self._newest.get(topic)
        if known is None or now_ns - known.received_ns > SOURCE_TIMEOUT_S * NS_PER_S:
            return ""
        if attachment.gid != known.gid:
            return f"{topic} has a second sender"
        return f"{topic} is out of order" if attachment.sequence <= known.sequence else ""

    def _raptor(self, state: VehicleState) -> tuple[float, float]:
        """Motor angle (deg), pedal (%), front pressure (kPa) as road-wheel angle and drive; rear brakes as declared."""
        train = self.config.powertrain
        actuation = Actuation(self.config.vehicle, train)
        motor = math.radians(self._newest[ros.STEERING_CMD.name].message.angle_cmd)
        pedal = min(max(self._newest[ros.ACCELERATOR_CMD.name].message.pedal_cmd / 100, 0.0), 1.0)
        front = max(self._newest[ros.BRAKE_CMD.name].message.pedal_cmd * 1e3, 0.0)
        rear = front * (1 - train.brake_bias_front) / train.brake_bias_front
        asked = ActuatorPositions(motor, pedal if front == 0 else 0.0, front, rear, state.gear)
        return actuation.to_steer(motor), _slip(actuation.to_drive(asked, state.engine_speed, state.gear))

    def _ackermann(self, state: VehicleState) -> tuple[float, float]:
        """Angle as it is; the speed is approached by at most the given acceleration, 0: the gateway's own braking."""
        drive = self._newest[ros.ACKERMANN_CMD.name].message.drive
        most = abs(drive.acceleration) or self.config.gateway.stop.controlled_deceleration
        wanted = (drive.speed - road_speed(state)) / SPEED_TIME_S
        force = self.config.vehicle.mass * min(max(wanted, -most), most)
        return drive.steering_angle, _slip(force / self.config.powertrain.force_per_drive)


NEEDED: dict[str, tuple[str, ...]] = {
    "none": (),
    "raptor": (ros.STEERING_CMD.name, ros.ACCELERATOR_CMD.name, ros.BRAKE_CMD.name),
    "ackermann": (ros.ACKERMANN_CMD.name,),
}
"""`ros2.commands` -> topics without which there is no command; the first names the sender"""
NUMBERS: dict[str, tuple[tuple[str, float, float], ...]] = {
    ros.STEERING_CMD.type: (("angle_cmd", -1e3, 1e3),),
    ros.ACCELERATOR_CMD.type: (("pedal_cmd", -1e3, 1e3),),
    ros.BRAKE_CMD.type: (("pedal_cmd", -1e5, 1e5),),
    ros.ACKERMANN_CMD.type: (("steering_angle", -7.0, 7.0), ("speed", 0.0, 200.0), ("acceleration", -200.0, 200.0)),
}
"""type -> fields that are used, with bounds far outside what a car can do; it has no reverse"""


def _usable(name: str, message: Any) -> bool:
    """Whether the fields that are used are numbers within bounds."""
    holder = getattr(message, "drive", message)
    return all(low <= getattr(holder, number) <= high for number, low, high in NUMBERS[name])


def _unix_stamp(message: Any, source_ns: int) -> int:
    header = getattr(message, "header", None)
    stamp_ns = header.stamp.sec * NS_PER_S + header.stamp.nanosec if header is not None else 0
    return min(stamp_ns, source_ns) if stamp_ns > 0 else source_ns


def _slip(drive: float) -> float:
    """Within what a command may hold."""
    return min(max(drive, -1.0), 1.0)
