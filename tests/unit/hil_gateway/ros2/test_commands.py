"""Commands of ROS nodes: what they come to, how old they are, and why they are refused."""

from __future__ import annotations

import math

import pytest
from support.cars import car_messages
from support.cars.ros_peer import encode

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import Command, FailsafeAction
from hil_gateway.bus.topics import COMMAND, ROS2_COMMAND
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.inbox import Inbox
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.incoming import Incoming
from hil_gateway.ros2.session import ReceivedSample
from hil_gateway.ros2.types import Types
from hil_gateway.ros2.wire import Attachment

TYPES = Types("av24")
UNIX_NS = 1_800_000_000 * NS_PER_S
GID, OTHER = b"a" * 16, b"b" * 16
MS = 1_000_000


def steering(degrees: float) -> bytes:
    return encode([("f", degrees), ("f", 0), ("?", True), ("?", False), ("B", 1), ("f", 0), ("f", 0), ("B", 0)])


def accelerator(percent: float) -> bytes:
    numbers = [("f", 0.0), ("f", 0.0), ("?", True), ("?", False), ("B", 1), ("f", 0), ("B", 0), ("f", 0), ("f", 0)]
    return encode([("f", percent), *numbers])


def brake(kilopascal: float) -> bytes:
    return encode([("f", kilopascal), ("?", True), ("B", 1), ("f", 0), ("f", 0), ("B", 0), ("f", 0), ("B", 0)])


def ackermann(angle: float, speed: float, acceleration: float = 0.0, stamp_ns: int = 0) -> bytes:
    header = [("i", stamp_ns // NS_PER_S), ("I", stamp_ns % NS_PER_S), ("s", "base_link")]
    return encode([*header, ("f", angle), ("f", 0), ("f", speed), ("f", acceleration), ("f", 0)])


class Rig:
    def __init__(self, commands: str) -> None:
        config = Config.model_validate({"ros2": {"commands": commands}})
        self.config = config
        self.incoming = Incoming(config, TYPES, "1234abcd", lambda gid: "/follower" if gid == GID else "")
        self._sequence = 0

    def take(self, topic: ros.RosTopic, data: bytes, now_ns: int, age_ns: int = 0, gid: bytes = GID) -> str:
        self._sequence += 1
        attachment = Attachment(self._sequence, UNIX_NS + now_ns - age_ns, gid)
        return self.incoming.take(ReceivedSample(topic, data, attachment), now_ns, UNIX_NS)

    def raptor(self, now_ns: int, degrees: float, percent: float, kilopascal: float) -> Command:
        assert self.take(ros.STEERING_CMD, steering(degrees), now_ns, 1 * MS) == ""
        assert self.take(ros.ACCELERATOR_CMD, accelerator(percent), now_ns, 7 * MS) == ""
        assert self.take(ros.BRAKE_CMD, brake(kilopascal), now_ns, 2 * MS) == ""
        command = self.command(now_ns)
        assert command is not None
        return command

    def command(self, now_ns: int) -> Command | None:
        speeds = {f"wheel_speed_{corner}": 20.0 for corner in ("fl", "fr", "rl", "rr")}
        return self.incoming.command(now_ns, car_messages.vehicle_state(now_ns, gear=3, engine_speed=500.0, **speeds))


def test_raptor_command_is_motor_angle_over_the_ratio_and_as_old_as_its_oldest_part():
    command = Rig("raptor").raptor(NS_PER_S, 150.0, 0.0, 0.0)
    assert command.steer == pytest.approx(math.radians(10.0))  # 15:1
    assert command.drive == 0.0
    assert command.state_stamp_ns == NS_PER_S - 7 * MS
    assert command.source == "ros2 1234 /follower"


def test_raptor_pedals_come_out_of_the_gateway_as_they_went_in():
    from hil_gateway.car.actuation import Actuation

    rig = Rig("raptor")
    actuation = Actuation(rig.config.vehicle, rig.config.powertrain)
    driving = actuation.to_actuators(0.0, rig.raptor(NS_PER_S, 0.0, 40.0, 0.0).drive, 3, 500.0, 3)
    assert driving.accelerator == pytest.approx(0.4, abs=1e-4)
    braking = actuation.to_actuators(0.0, rig.raptor(2 * NS_PER_S, 0.0, 40.0, 1000.0).drive, 3, 500.0, 3)
    assert (braking.accelerator, braking.brake_front) == (0.0, pytest.approx(1.0e6))
    assert braking.brake_front / (braking.brake_front + braking.brake_rear) == pytest.approx(0.54)


def test_part_that_is_missing_means_no_command_and_one_that_stops_coming_makes_it_old():
    rig = Rig("raptor")
    rig.take(ros.STEERING_CMD, steering(0.0), 0)
    assert rig.command(0) is None
    first = rig.raptor(100 * MS, 0.0, 0.0, 0.0)
    rig.take(ros.STEERING_CMD, steering(1.0), 400 * MS)
    later = rig.command(400 * MS)
    assert later is not None
    assert later.state_stamp_ns == first.state_stamp_ns  # the gateway refuses it as stale


def test_ackermann_command_is_as_old_as_the_stamp_in_its_header_where_that_is_earlier():
    rig = Rig("ackermann")
    stamp_ns = UNIX_NS + NS_PER_S - 30 * MS
    assert rig.take(ros.ACKERMANN_CMD, ackermann(0.1, 20.0, stamp_ns=stamp_ns), NS_PER_S, 1 * MS) == ""
    command = rig.command(NS_PER_S)
    assert command is not None
    assert (command.state_stamp_ns, command.drive) == (NS_PER_S - 30 * MS, pytest.approx(0.0))
    assert command.steer == pytest.approx(0.1)
    rig.take(ros.ACKERMANN_CMD, ackermann(0.1, 20.0, stamp_ns=0), 2 * NS_PER_S, 1 * MS)
    unstamped = rig.command(2 * NS_PER_S)
    assert unstamped is not None
    assert unstamped.state_stamp_ns == 2 * NS_PER_S - 1 * MS


@pytest.mark.parametrize(("speed", "limit", "expected"), [(40.0, 2.0, 2.0), (0.0, 3.0, -3.0), (20.5, 2.0, 1.0)])
def test_ackermann_speed_is_approached_by_at_most_the_acceleration(speed, limit, expected):
    rig = Rig("ackermann")
    rig.take(ros.ACKERMANN_CMD, ackermann(0.0, speed, limit), NS_PER_S)
    command = rig.command(NS_PER_S)
    assert command is not None
    force = command.drive * rig.config.powertrain.force_per_drive
    assert force / rig.config.vehicle.mass == pytest.approx(expected, rel=1e-6)


def test_what_is_refused_says_why():
    rig = Rig("ackermann")
    good = ackermann(0.0, 10.0)
    assert "attachment" in rig.incoming.take(ReceivedSample(ros.ACKERMANN_CMD, good, None), 0, UNIX_NS)
    for bad in (b"", good[:-1] + b"", ackermann(math.nan, 10.0), ackermann(0.0, math.inf), ackermann(0.0, -1.0)):
        assert "within its bounds" in rig.take(ros.ACKERMANN_CMD, bad, NS_PER_S)
    assert "ahead" in rig.take(ros.ACKERMANN_CMD, good, NS_PER_S, -6 * MS)
    assert rig.take(ros.ACKERMANN_CMD, good, NS_PER_S, -4 * MS) == ""
    assert "second sender" in rig.take(ros.ACKERMANN_CMD, good, NS_PER_S, gid=OTHER)
    repeated = Attachment(1, UNIX_NS + NS_PER_S, GID)
    assert "order" in rig.incoming.take(ReceivedSample(ros.ACKERMANN_CMD, good, repeated), NS_PER_S, UNIX_NS)
    assert rig.incoming.taken == 1
    assert rig.take(ros.ACKERMANN_CMD, good, 2 * NS_PER_S, gid=OTHER) == ""  # the first has been silent for a second


def test_gateway_takes_one_source_and_names_the_second():
    bus = LocalBus()
    inbox = Inbox(bus, 0.15)

    def send(topic, source: str, now_ns: int) -> None:
        numbers = {"stamp_ns": now_ns, "seq": now_ns, "state_stamp_ns": now_ns, "steer": 0.0, "drive": 0.0}
        bus.publish(topic, Command(source=source, **numbers))
        inbox.read_commands(now_ns, FailsafeAction.DRIVE)

    send(ROS2_COMMAND, "ros2 1234 /follower", 1 * MS)
    assert (inbox.command_source, inbox.second_source) == ("ros2 1234 /follower", "")
    send(COMMAND, "planner", 2 * MS)
    assert (inbox.command_source, inbox.second_source) == ("ros2 1234 /follower", "planner")
    assert inbox.refused == {"second_source": 1}
    send(ROS2_COMMAND, "ros2 1234 /follower", 2 * NS_PER_S)
    assert inbox.second_source == ""
