"""The car in ROS terms: judged on the bytes, taken apart by a reader that shares nothing with the bridge."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import pytest
from support.cars import car_messages
from support.cars.ros_peer import decode

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.can_link import EXTENDED_ID, VirtualWire
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, VirtualClock
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.bridge import Bridge
from hil_gateway.ros2.session import ReceivedSample
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types

UNIX_NS = 1_800_000_000 * NS_PER_S
"""Unix time at monotonic 0"""
TYPES = Types("av24")


class Recording:
    """A ROS side that remembers."""

    session = "me"

    def __init__(self) -> None:
        self.sent: defaultdict[RosTopic, list[bytes]] = defaultdict(list)
        self.unwanted: set[RosTopic] = set()
        self.changes: list[tuple[str, bool]] = []
        self.arrived: list[ReceivedSample] = []

    def wanted(self, topic: RosTopic) -> bool:
        return topic not in self.unwanted

    def publish(self, topic: RosTopic, data: bytes, unix_ns: int) -> None:
        self.sent[topic].append(data)

    def received(self) -> list[ReceivedSample]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def graph_changes(self) -> list[tuple[str, bool]]:
        changes, self.changes = self.changes, []
        return changes


class Rig:
    def __init__(self, **ros2: Any) -> None:
        self.bus, self.node, wire = LocalBus(), Recording(), VirtualWire(VirtualClock())
        self.car = wire.link()
        self.bridge = Bridge(Config.model_validate({"ros2": ros2}), self.bus, wire.link(), TYPES, self.node)
        self.statuses = self.bus.subscribe(topics.ROS2_STATUS, depth=100)

    def step(self, now_ns: int) -> None:
        self.bridge.step(now_ns, UNIX_NS)

    def only(self, topic: RosTopic) -> dict[str, Any]:
        (data,) = self.node.sent[topic]
        return decode(TYPES.of(topic.type).dds, data)

    def diagnosed(self) -> dict[str, tuple[int, str]]:
        """Name -> level and message of the newest array."""
        array = TYPES.from_bytes(ros.DIAGNOSTICS.type, self.node.sent[ros.DIAGNOSTICS][-1])
        assert array is not None
        return {row.name: (row.level, row.message) for row in array.status}


def test_odometry_has_pose_velocity_and_variances_at_the_time_of_the_state():
    rig = Rig()
    moves = {"x": 10.0, "y": -4.0, "yaw": math.pi / 2, "vx": 30.0, "vy": -0.5, "yaw_rate": 0.2}
    rig.bus.publish(topics.ESTIMATE, car_messages.estimate(2 * NS_PER_S, **moves))
    rig.step(2 * NS_PER_S + 5)
    got = rig.only(ros.ODOMETRY)
    assert (got["time.sec"], got["time.nanosec"]) == (1_800_000_002, 0)
    assert (got["frame_id"], got["child"]) == ("map", "base_link")
    assert (got["x"], got["y"], got["vx"], got["vy"], got["wz"]) == (10.0, -4.0, 30.0, -0.5, 0.2)
    assert (got["qz"], got["qw"]) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))  # a quarter turn to the left
    assert [got["pose_covariance"][i] for i in (0, 7, 35)] == [1, 4, 9]  # deviations 1, 2, 3 of x, y, yaw
    assert [got["twist_covariance"][i] for i in (0, 7, 35)] == [16, 25, 36]
    assert min(got["pose_covariance"][i] for i in (14, 21, 28)) > 1e5  # height, roll and pitch are not known
    assert sum(value != 0 for value in got["pose_covariance"]) == 6


def test_estimate_that_no_plan_may_depend_on_is_no_odometry_but_said_in_the_diagnostics():
    rig = Rig()
    rig.bus.publish(topics.ESTIMATE, car_messages.estimate(0, valid=False, lacks="heading"))
    rig.step(0)
    assert not rig.node.sent[ros.ODOMETRY]
    assert not rig.node.sent[ros.TF]
    assert rig.diagnosed()["av24: estimate"] == (1, "lacks heading")


def test_imu_says_which_parts_it_does_not_know():
    rig = Rig()
    rig.bus.publish(topics.VEHICLE_STATE, car_messages.vehicle_state(0, ax=1.5, ay=-9.0, az=9.8, yaw_rate=-0.3))
    rig.step(1)
    got = rig.only(ros.IMU)
    assert (got["ax"], got["ay"], got["az"], got["wz"]) == (1.5, -9.0, 9.8, -0.3)
    assert got["turn_covariance"][0] == -1  # sensor_msgs/Imu: no orientation
    assert got["rate_covariance"][4] > 1e5  # no pitch rate


@pytest.mark.parametrize("generation", ["av24", "av21"])
def test_reports_are_in_the_units_that_drive_by_wire_nodes_use(generation):
    node = Recording()
    types, bus, wire = Types(generation), LocalBus(), VirtualWire(VirtualClock())
    bridge = Bridge(Config.model_validate({"ros2": {"messages": generation}}), bus, wire.link(), types, node)
    moves = {
        "wheel_speed_fl": 10.0, "wheel_speed_rr": 20.0, "steer": math.radians(2.0), "accelerator": 0.25,
        "brake_front": 2.0e6, "brake_rear": 1.5e6, "engine_speed": 200.0 * math.pi, "gear": 4,
    }  # fmt: skip
    bus.publish(topics.VEHICLE_STATE, car_messages.vehicle_state(0, **moves))
    bridge.step(1, UNIX_NS)
    wheels = decode(types.of(ros.WHEEL_SPEEDS.type).dds, node.sent[ros.WHEEL_SPEEDS][0])
    assert (wheels["fl"], wheels["rr"], wheels["frame_id"]) == (36.0, 72.0, "base_link")
    read = {t: types.from_bytes(t.type, node.sent[t][0]) for t in ros.REPORTS[1:]}
    assert read[ros.STEERING].steering_wheel_angle == pytest.approx(30.0)  # of the motor: 15 to 1
    assert read[ros.ACCELERATOR].pedal_output == 25.0
    brakes = read[ros.BRAKES]
    assert (brakes.front_brake_pressure, brakes.rear_brake_pressure) == (2000.0, 1500.0)
    engine = read[ros.ENGINE]
    assert (engine.engine_rpm, engine.current_gear, engine.stamp.sec) == (6000.0, 4, UNIX_NS // 10**9)


def test_frames_pass_with_identifier_length_and_bytes():
    rig = Rig()
    rig.car.send(0x514, b"\x01\x02\x03\x04\x05\x06\x07\x08")
    rig.car.send(EXTENDED_ID | 0x1ABCDE, b"\xff")
    rig.step(0)
    first, second = (decode(TYPES.of(ros.FRAMES.type).dds, data) for data in rig.node.sent[ros.FRAMES])
    assert (first["id"], first["dlc"], first["data"]) == (0x514, 8, (1, 2, 3, 4, 5, 6, 7, 8))
    assert (second["id"], second["is_extended"], second["dlc"], second["data"][0]) == (0x1ABCDE, True, 1, 0xFF)
    assert not first["is_extended"] and not first["is_rtr"] and not first["is_error"]


def test_plan_is_a_path_whose_poses_have_their_times():
    rig = Rig()
    rig.bus.publish(topics.PLAN, car_messages.plan(NS_PER_S))
    rig.step(NS_PER_S)
    path = TYPES.from_bytes(ros.PLAN.type, rig.node.sent[ros.PLAN][0])
    assert path is not None
    assert [pose.pose.position.x for pose in path.poses] == [0.0, 0.5, 1.0]
    assert [pose.header.stamp.nanosec for pose in path.poses] == [0, 50_000_000, 100_000_000]


def test_diagnostics_give_failsafe_with_its_cause_and_every_source_with_its_age():
    rig = Rig()
    rig.bus.publish(topics.VEHICLE_STATE, car_messages.vehicle_state(0))
    stop = car_messages.gateway_status(0, action=FailsafeAction.CONTROLLED_STOP, cause="position_lost")
    rig.bus.publish(topics.GATEWAY_STATUS, stop)
    rig.step(0)
    rows = rig.diagnosed()
    assert rows["av24: failsafe"] == (1, "controlled_stop: position_lost")
    assert rows["av24: imu"] == (0, "0.004 s old")
    assert rows["av24: position"] == (3, "never received")


def test_gateway_that_falls_silent_is_said_to_be():
    rig = Rig()
    rig.bus.publish(topics.GATEWAY_STATUS, car_messages.gateway_status(0))
    rig.step(0)
    rig.step(2 * NS_PER_S)
    assert rig.diagnosed()["av24: failsafe"] == (3, "the gateway is silent for 2.0 s")


def test_axles_are_told_once_for_late_joiners():
    rig = Rig()
    for millisecond in range(300):
        rig.step(millisecond * 1_000_000)
    (data,) = rig.node.sent[ros.TF_STATIC]
    message = TYPES.from_bytes(ros.TF_STATIC.type, data)
    assert message is not None
    assert {t.child_frame_id: t.transform.translation.x for t in message.transforms} == {
        "front_axle": pytest.approx(1.724),
        "rear_axle": pytest.approx(-1.248),
    }


def test_nothing_is_made_for_topics_that_nobody_subscribes():
    rig = Rig()
    rig.node.unwanted = {ros.FRAMES, ros.ODOMETRY, ros.TF}
    rig.car.send(0x514, bytes(8))
    rig.bus.publish(topics.ESTIMATE, car_messages.estimate(0))
    rig.step(0)
    assert not any(rig.node.sent[topic] for topic in rig.node.unwanted)


def test_what_keeps_a_node_apart_is_logged_once_and_stands_in_status_and_diagnostics(caplog):
    rig = Rig()
    of = TYPES.of(ros.ODOMETRY.type)
    token = f"@ros2_lv/0/them/0/1/MS/%/%/viewer/%av24%odometry/{of.dds}/TypeHashNotSupported/::,10:,:,:,,"
    rig.node.changes = [(token, True)]
    rig.step(0)
    rig.node.changes = [("@ros2_lv/0/them/0/0/NN/%/%/viewer", True)]
    rig.step(NS_PER_S)
    assert sum("/viewer expects /av24/odometry" in record.message for record in caplog.records) == 1
    *_, status = rig.statuses.poll(0)
    assert (status.nodes, len(status.notes)) == (1, 1)
    assert rig.diagnosed()["av24: ros2"] == (1, status.notes[0])
