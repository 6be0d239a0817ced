"""Messages of the bus as ROS messages. Pure.

Frames: `map` is the local map (x east, y north of the configured origin), `base_link` lies at the centre of gravity, x
forward, y left, z up (REP 103). What is not measured has the variance `UNKNOWN`. Stamps are Unix time.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from hil_gateway.bus.messages import Estimate, FailsafeAction, GatewayStatus, Plan, VehicleState
from hil_gateway.car.powertrain import RPM
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types

MAP, BASE = "map", "base_link"
UNKNOWN = 1e6
"""variance of what is not measured: filters give it no weight"""
IMU_VARIANCES = (1e-4, 0.1)
"""(rad/s)^2 and (m/s2)^2 of an inertial sensor on a race car, with vibration"""


class Level(IntEnum):
    """Of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


LEVELS = {
    FailsafeAction.SILENT: Level.OK,
    FailsafeAction.DRIVE: Level.OK,
    FailsafeAction.CONTROLLED_STOP: Level.WARN,
    FailsafeAction.EMERGENCY_STOP: Level.ERROR,
}
Status = tuple[str, Level, str, Sequence[tuple[str, str]]]
"""name, level, message, values"""


class Outgoing:
    """Makes the messages; `unix_ns` is what every stamp is in: Unix time, ns."""

    def __init__(self, types: Types) -> None:
        self._types = types

    def time(self, unix_ns: int) -> Any:
        """builtin_interfaces/Time."""
        return self._types["builtin_interfaces/msg/Time"](*divmod(unix_ns, NS_PER_S))

    def header(self, unix_ns: int, frame_id: str) -> Any:
        """std_msgs/Header."""
        return self._types["std_msgs/msg/Header"](self.time(unix_ns), frame_id)

    def odometry(self, estimate: Estimate, unix_ns: int) -> Any:
        """nav_msgs/Odometry: pose in `map`, velocity in `base_link`."""
        x, y, yaw, vx, vy, yaw_rate, *_ = (deviation**2 for deviation in estimate.std)
        types = self._types
        twist = types["geometry_msgs/msg/Twist"](
            self._vector(estimate.vx, estimate.vy), self._vector(0.0, 0.0, estimate.yaw_rate)
        )
        pose = types["geometry_msgs/msg/PoseWithCovariance"](
            self._pose(estimate.x, estimate.y, estimate.yaw), _diagonal(x, y, UNKNOWN, UNKNOWN, UNKNOWN, yaw)
        )
        moves = types["geometry_msgs/msg/TwistWithCovariance"](
            twist, _diagonal(vx, vy, UNKNOWN, UNKNOWN, UNKNOWN, yaw_rate)
        )
        return types["nav_msgs/msg/Odometry"](self.header(unix_ns, MAP), BASE, pose, moves)

    def imu(self, state: VehicleState, unix_ns: int) -> Any:
        """sensor_msgs/Imu: what the car reports, without orientation (its covariance begins with -1) and pitch rate."""
        rates, accelerations = IMU_VARIANCES
        return self._types["sensor_msgs/msg/Imu"](
            self.header(unix_ns, BASE),
            self._quaternion(0.0),
            _diagonal(-1.0, 0.0, 0.0),
            self._vector(state.roll_rate, 0.0, state.yaw_rate),
            _diagonal(rates, UNKNOWN, rates),
            self._vector(state.ax, state.ay, state.az),
            _diagonal(accelerations, accelerations, accelerations),
        )

    def report(self, topic: RosTopic, state: VehicleState, steering_ratio: float, unix_ns: int) -> Any:
        """A report as the teams' drive-by-wire node fills it: km/h, deg at the motor, %, kPa and rpm; what the car does
        not say is 0."""
        values = {
            ros.WHEEL_SPEEDS: {
                "front_left": 3.6 * state.wheel_speed_fl, "front_right": 3.6 * state.wheel_speed_fr,
                "rear_left": 3.6 * state.wheel_speed_rl, "rear_right": 3.6 * state.wheel_speed_rr,
            },
            ros.STEERING: {"steering_wheel_angle": math.degrees(state.steer * steering_ratio)},
            ros.ACCELERATOR: {"pedal_output": 100.0 * state.accelerator},
            ros.BRAKES: {
                "front_brake_pressure": 1e-3 * state.brake_front, "rear_brake_pressure": 1e-3 * state.brake_rear,
            },
            ros.ENGINE: {"engine_rpm": state.engine_speed / RPM, "current_gear": state.gear},
        }[topic]  # fmt: skip
        kind, mode = self._types[topic.type], self._types["raptor_dbw_msgs/msg/ActuatorControlMode"](0)
        stamps = {"header": self.header(unix_ns, BASE), "stamp": self.time(unix_ns)}
        known = {**stamps, "control_type": mode, **values}
        return kind(**{field.name: known.get(field.name, 0) for field in dataclasses.fields(kind) if field.init})

    def path(self, plan: Plan, unix_ns: int) -> Any:
        """nav_msgs/Path: the poses of the plan, each with the time it is meant for."""
        step_ns = round(plan.dt * NS_PER_S)
        stamped = self._types["geometry_msgs/msg/PoseStamped"]
        poses = [
            stamped(self.header(unix_ns + i * step_ns, MAP), self._pose(x, y, yaw))
            for i, (x, y, yaw) in enumerate(zip(plan.x, plan.y, plan.yaw, strict=True))
        ]
        return self._types["nav_msgs/msg/Path"](self.header(unix_ns, MAP), poses)

    def car_in_map(self, estimate: Estimate, unix_ns: int) -> Any:
        """tf2_msgs/TFMessage: `base_link` in `map`."""
        at = self._vector(estimate.x, estimate.y)
        return self._transforms([(MAP, BASE, at, self._quaternion(estimate.yaw))], unix_ns)

    def axles(self, lf: float, lr: float, unix_ns: int) -> Any:
        """tf2_msgs/TFMessage: the middles of the axles in `base_link`; `lf`, `lr` (m) from the centre of gravity."""
        places = {"front_axle": lf, "rear_axle": -lr}
        straight = self._quaternion(0.0)
        return self._transforms([(BASE, name, self._vector(x, 0.0), straight) for name, x in places.items()], unix_ns)

    def diagnostics(self, statuses: Iterable[Status], unix_ns: int) -> Any:
        """diagnostic_msgs/DiagnosticArray."""
        types = self._types
        pair, status = types["diagnostic_msgs/msg/KeyValue"], types["diagnostic_msgs/msg/DiagnosticStatus"]
        rows = [
            status(level, name, message, "av24", [pair(key, value) for key, value in values])
            for name, level, message, values in statuses
        ]
        return types["diagnostic_msgs/msg/DiagnosticArray"](self.header(unix_ns, ""), rows)

    def _transforms(self, rows: Iterable[tuple[str, str, Any, Any]], unix_ns: int) -> Any:
        stamped, transform = (self._types[f"geometry_msgs/msg/{name}"] for name in ("TransformStamped", "Transform"))
        turned = [stamped(self.header(unix_ns, parent), child, transform(at, q)) for parent, child, at, q in rows]
        return self._types["tf2_msgs/msg/TFMessage"](turned)

    def _pose(self, x: float, y: float, yaw: float) -> Any:
        types = self._types
        return types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](x, y, 0.0), self._quaternion(yaw))

    def _quaternion(self, yaw: float) -> Any:
        return self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    def _vector(self, x: float, y: float, z: float = 0.0) -> Any:
        return self._types["geometry_msgs/msg/Vector3"](x, y, z)


def gateway_status(status: GatewayStatus) -> Status:
    """The failsafe with its cause, and what is missing for arming."""
    values = [
        ("mode", status.mode),
        ("armed", str(status.armed)),
        ("cause", status.cause),
        ("missing_for_arming", ", ".join(status.missing_for_arming)),
        ("bus", f"{status.bus} {status.bus_state}"),
        ("frames_lost", str(status.frames_lost)),
        ("detail", status.detail),
    ]
    message = f"{status.action}: {status.cause}" if status.cause else str(status.action)
    return "av24: failsafe", LEVELS[status.action], message, values


def source_statuses(state: VehicleState) -> Iterable[Status]:
    """Every group of reports with its age."""
    for name, health in state.sources.items():
        never = health.age_s is None
        age = "never received" if never else f"{health.age_s:.3f} s old"
        level = Level.STALE if never else Level.OK if health.valid else Level.ERROR
        yield f"av24: {name}", level, age if health.valid or never else f"invalid, {age}", [("age_s", age)]


def estimate_status(estimate: Estimate | None, age_s: float) -> Status:
    """Whether the estimate is there and what it lacks."""
    if estimate is None:
        return "av24: estimate", Level.STALE, "never received", []
    lacks = estimate.lacks or ("" if estimate.valid else "invalid")
    return (
        "av24: estimate",
        Level.WARN if lacks else Level.OK,
        f"lacks {lacks}" if lacks else "valid",
        [("age_s", f"{age_s:.3f}")],
    )


def _diagonal(*variances: float) -> Any:
    return np.diag(variances).ravel()
