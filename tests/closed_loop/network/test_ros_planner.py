"""The example planner over ROS 2 messages: every message goes through the bridge as bytes, both ways."""

from __future__ import annotations

from typing import Any

import pytest
from support.examples import load_example

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.can_link import Frame
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.bridge import Bridge
from hil_gateway.ros2.session import ReceivedSample
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types
from hil_gateway.ros2.wire import Attachment
from hil_gateway.track.track import Track
from planner.simulation.loop import Loop

UNIX_OFFSET_NS = 1_700_000_000 * NS_PER_S
IN_THE_BEND = 350.0
"""m along the oval"""


class Team:
    """A team's computer: the example behind the ROS side of the bridge; it has nothing else of the car."""

    session = "0123456789abcdef"

    def __init__(self, config: Config, bus: LocalBus, track: Track, speed: float) -> None:
        self._types = Types(config.ros2.messages)
        self._follower = load_example("my_ros_planner").Follower(track, config.vehicle.wheelbase, speed)
        self._odometry: Any = None
        self._sent = 0
        self._received: list[ReceivedSample] = []
        self._bridge = Bridge(config, bus, self, self._types, self)  # type: ignore[arg-type]

    def step(self, now_ns: int) -> None:
        """50 ms: what the bridge has published is answered, and the bridge hears the answer."""
        self._bridge.step(now_ns, UNIX_OFFSET_NS)
        steer, speed = self._follower.answer(self._odometry)
        header = self._types["std_msgs/msg/Header"](self._stamp(now_ns), "base_link")
        drive = self._types["ackermann_msgs/msg/AckermannDrive"](steer, 0.0, speed, 0.0, 0.0)
        message = self._types["ackermann_msgs/msg/AckermannDriveStamped"](header, drive)
        data = self._types.to_bytes(ros.ACKERMANN_CMD.type, message)
        self._sent += 1
        attachment = Attachment(self._sent, now_ns + UNIX_OFFSET_NS, bytes(16))
        self._received.append(ReceivedSample(ros.ACKERMANN_CMD, data, attachment))
        self._bridge.step(now_ns, UNIX_OFFSET_NS)

    def _stamp(self, now_ns: int) -> Any:
        if self._odometry is not None:
            return self._odometry.header.stamp
        return self._types["builtin_interfaces/msg/Time"](*divmod(now_ns + UNIX_OFFSET_NS, NS_PER_S))

    def wanted(self, topic: RosTopic) -> bool:
        return topic in {ros.ODOMETRY, ros.DIAGNOSTICS}

    def publish(self, topic: RosTopic, data: bytes, unix_ns: int) -> None:
        if topic is ros.ODOMETRY:
            self._odometry = self._types.from_bytes(topic.type, data)

    def received(self) -> list[ReceivedSample]:
        received, self._received = self._received, []
        return received

    def graph_changes(self) -> list[tuple[str, bool]]:
        return []

    def receive(self, timeout_s: float) -> list[Frame]:
        return []


def drive(start_s: float, speed: float, **until: Any) -> Loop:
    config = Config.model_validate({
        "track": "oval", "plant": {"start_s": start_s}, "ros2": {"commands": "ackermann"},
    })  # fmt: skip
    made = {"planner": lambda config, bus, track: Team(config, bus, track, speed)}
    loop = Loop(config, keep=(topics.GATEWAY_STATUS,), components=made)
    loop.run(**until)
    return loop


def test_it_drives_round_a_bend_over_ros_messages_through_arming_and_limits() -> None:
    loop = drive(IN_THE_BEND, 10.0, seconds=7.0, time_limit_s=14.0)
    assert (loop.result.armed, loop.result.failsafes, loop.result.off_track) == (True, [], 0)
    assert loop.plant.car["vx"] == pytest.approx(10.0, abs=1.0)
    assert abs(loop.plant.car["yaw_rate"]) > 0.03, "it is in a bend"
    assert abs(loop.plant.car.road.lateral) < 1.0
    status = loop.result.messages[topics.GATEWAY_STATUS.key][-1]
    assert getattr(status, "command_source", "").startswith("ros2 0123")


@pytest.mark.long
@pytest.mark.slow
def test_it_drives_a_lap_over_ros_messages() -> None:
    result = drive(0.0, 22.0, laps=1, time_limit_s=200.0).result
    assert (result.laps, result.failsafes, result.off_track) == (1, [], 0)
