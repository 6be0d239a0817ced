"""Bags of drive messages as Indy teams record them, written by rosbags: a drive as receivers, IMU and car say it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hil_gateway.config import OriginConfig
from hil_gateway.process.arrays import Array
from hil_gateway.track.geodesy import LocalMap

START_NS = 1_795_627_917_000_000_000
GPS_S = START_NS // 1_000_000_000 - 315_964_800 + 18
RATIO = 15.0
PLACE = OriginConfig(latitude=36.5865, longitude=-121.7550)
# as in the packages' .msg files (novatel_oem7_msgs of the Indy teams, raptor_dbw_msgs)
OEM7_HEADER = """string message_name
uint16 message_id
uint8 message_type
uint32 sequence_number
uint8 time_status
uint16 gps_week_number
uint32 gps_week_milliseconds
uint8 idle_time"""
HEADERS = "std_msgs/Header header\nOem7Header nov_header\n"
DEFINITIONS = {
    "novatel_oem7_msgs/msg/Oem7Header": OEM7_HEADER,
    "novatel_oem7_msgs/msg/SolutionStatus": "uint32 status",
    "novatel_oem7_msgs/msg/PositionOrVelocityType": "uint32 type",
    "novatel_oem7_msgs/msg/InertialSolutionStatus": "uint32 status",
    "novatel_oem7_msgs/msg/INSPVA": HEADERS
    + "float64 latitude\nfloat64 longitude\nfloat64 height\nfloat64 north_velocity\nfloat64 east_velocity\n"
    "float64 up_velocity\nfloat64 roll\nfloat64 pitch\nfloat64 azimuth\nInertialSolutionStatus status",
    "novatel_oem7_msgs/msg/BESTVEL": HEADERS
    + "SolutionStatus sol_status\nPositionOrVelocityType vel_type\nfloat32 latency\nfloat32 diff_age\n"
    "float64 hor_speed\nfloat64 trk_gnd\nfloat64 ver_speed\nfloat32 reserved",
    "novatel_oem7_msgs/msg/RAWIMU": HEADERS
    + "uint32 gnss_week\nfloat64 gnss_seconds\nuint32 status\ngeometry_msgs/Vector3 linear_acceleration\n"
    "geometry_msgs/Vector3 angular_velocity",
    "raptor_dbw_msgs/msg/ActuatorControlMode": "uint8 value",
    "raptor_dbw_msgs/msg/WheelSpeedReport": "std_msgs/Header header\nfloat32 front_left\nfloat32 front_right\n"
    "float32 rear_left\nfloat32 rear_right",
    "raptor_dbw_msgs/msg/SteeringReport": "std_msgs/Header header\nfloat32 steering_wheel_angle\n"
    "float32 steering_wheel_angle_cmd\nfloat32 steering_wheel_torque\nbool enabled\nbool driver_activity\n"
    "bool fault_steering_system\nbool overheat_prevention_mode\nuint8 rolling_counter\n"
    "ActuatorControlMode control_type\nbool steering_overheat_warning",
}
Message = tuple[str, str, int, Any]
"""topic, type, Unix ns of the recorder, message"""


def store(definitions: Mapping[str, str] = DEFINITIONS) -> Any:
    types = get_typestore(Stores.ROS2_HUMBLE)
    parsed = {}
    for name, fields in definitions.items():
        parsed |= get_types_from_msg(fields, name)
    types.register(parsed)
    return types


class Car:
    """Messages of a drive: columns t, vx, vy, yaw_rate, ax, ay, steer, x, y, yaw of docs/formats.md."""

    def __init__(self, columns: Mapping[str, Array], types: Any) -> None:
        self._columns, self._types, self._map = columns, types.types, LocalMap(PLACE)

    def at(self, name: str, t: Array) -> Array:
        return np.interp(t, self._columns["t"] - self._columns["t"][0], self._columns[name])

    def times(self, rate: float) -> Array:
        return np.arange(0.0, float(self._columns["t"][-1] - self._columns["t"][0]), 1.0 / rate)

    def header(self, t: float, frame: str = "base_link") -> Any:
        ns = START_NS + round(1e9 * t)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self._types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)

    def oem7(self, t: float, name: str) -> Any:
        week, seconds = divmod(GPS_S + t, 604_800)
        return self._types["novatel_oem7_msgs/msg/Oem7Header"](name, 1, 0, 0, 180, int(week), round(1e3 * seconds), 0)

    def imu(self, topic: str = "/imu", rate: float = 100.0) -> Iterator[Message]:
        """sensor_msgs/Imu mounted as the car drives."""
        t = self.times(rate)
        nothing, level = np.zeros(9), self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        for s, ax, ay, rate_ in zip(t, *(self.at(n, t) for n in ("ax", "ay", "yaw_rate")), strict=True):
            turning, force = self.vector(0.0, 0.0, rate_), self.vector(ax, ay, 9.81)
            message = self._types["sensor_msgs/msg/Imu"](
                self.header(s), level, nothing, turning, nothing, force, nothing
            )
            yield topic, "sensor_msgs/msg/Imu", START_NS + round(1e9 * s), message

    def raw_imu(self, topic: str, late_s: float) -> Iterator[Message]:
        """RAWIMU of a unit that sits turned by 180 degrees: x to the left of the car, y backwards."""
        t = self.times(125.0)
        for s, ax, ay, rate in zip(t, *(self.at(n, t) for n in ("ax", "ay", "yaw_rate")), strict=True):
            force, turning = self.vector(ay, -ax, 9.81), self.vector(0.0, 0.0, rate)
            kind = "novatel_oem7_msgs/msg/RAWIMU"
            message = self._types[kind](self.header(s + late_s), self.oem7(s, "RAWIMU"), 2300, s, 0, force, turning)
            yield topic, kind, START_NS + round(1e9 * (s + late_s)), message

    def inertial(self, topic: str, late_s: float) -> Iterator[Message]:
        """INSPVA at 50 Hz; its first five are not aligned yet."""
        t = self.times(50.0)
        columns = (self.at(n, t) for n in ("x", "y", "yaw", "vx", "vy"))
        for i, (s, x, y, yaw, vx, vy) in enumerate(zip(t, *columns, strict=True)):
            latitude, longitude = self._map.to_geodetic(x, y)
            north, east = vx * np.sin(yaw) + vy * np.cos(yaw), vx * np.cos(yaw) - vy * np.sin(yaw)
            status = self._types["novatel_oem7_msgs/msg/InertialSolutionStatus"](3 if i > 4 else 1)
            kind, azimuth = "novatel_oem7_msgs/msg/INSPVA", (90.0 - np.degrees(yaw)) % 360.0
            message = self._types[kind](
                self.header(s + late_s), self.oem7(s, "INSPVA"), latitude, longitude, 100.0, north, east, 0.0, 0.0, 0.0,
                azimuth, status,
            )  # fmt: skip
            yield topic, kind, START_NS + round(1e9 * (s + late_s)), message

    def wheels(self, late_s: float = 0.0, slip: float = 0.0) -> Iterator[Message]:
        """km/h, each sent twice with one stamp; the rear wheels slip by `slip` a m/s2 forward."""
        t = self.times(100.0)
        at = 3.6 * self.at("vx", t - late_s), 1.02 + slip * self.at("ax", t - late_s)
        for s, vx, rear in zip(t, *at, strict=True):
            kind = "raptor_dbw_msgs/msg/WheelSpeedReport"
            message = self._types[kind](self.header(s), vx, vx, rear * vx, rear * vx)
            for again_ns in (0, 5_000_000):
                yield "/raptor/wheel_speed_report", kind, START_NS + round(1e9 * s) + again_ns, message

    def steering(self) -> Iterator[Message]:
        """deg of the motor."""
        t = self.times(100.0)
        for s, steer in zip(t, np.degrees(RATIO * self.at("steer", t)), strict=True):
            mode = self._types["raptor_dbw_msgs/msg/ActuatorControlMode"](0)
            kind = "raptor_dbw_msgs/msg/SteeringReport"
            no = [False] * 4
            message = self._types[kind](self.header(s), steer, 0.0, 0.0, *no, 0, mode, False)
            yield "/raptor/steering_report", kind, START_NS + round(1e9 * s), message

    def odometry(self, rate: float = 50.0, *, on_map: bool = False) -> Iterator[Message]:
        """nav_msgs/Odometry; `on_map`: its twist is along the map's axes."""
        t = self.times(rate)
        types = {name: self._types[f"geometry_msgs/msg/{name}"] for name in (
            "Quaternion", "Pose", "PoseWithCovariance", "Twist", "TwistWithCovariance")}  # fmt: skip
        columns = (self.at(n, t) for n in ("x", "y", "yaw", "vx", "vy", "yaw_rate"))
        for s, x, y, yaw, vx, vy, turning in zip(t, *columns, strict=True):
            turned = (vx + 1j * vy) * np.exp(1j * yaw) if on_map else vx + 1j * vy
            heading = types["Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
            pose = types["PoseWithCovariance"](types["Pose"](self.vector(x, y, 0.0, "Point"), heading), np.zeros(36))
            speed = self.vector(float(turned.real), float(turned.imag), 0.0)
            twist = types["TwistWithCovariance"](types["Twist"](speed, self.vector(0.0, 0.0, turning)), np.zeros(36))
            message = self._types["nav_msgs/msg/Odometry"](self.header(s, "map"), "base_link", pose, twist)
            yield "/odom", "nav_msgs/msg/Odometry", START_NS + round(1e9 * s), message


def write(folder: Path, messages: list[Message], types: Any, storage: str = "mcap") -> Path:
    """A bag of these messages."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        add(writer, messages, types)
    return folder


def add(writer: Writer, messages: list[Message], types: Any) -> None:
    """Messages in the order of the recorder."""
    connections: dict[str, Any] = {}
    for topic, kind, ns, message in sorted(messages, key=lambda m: m[2]):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(connections[topic], ns, types.serialize_cdr(message, kind))
