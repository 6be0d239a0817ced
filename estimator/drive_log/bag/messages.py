"""What each kind of message says of the drive, in SI and ISO 8855 axes, whatever its fields and their comments say.

Positions are degrees here and go on a map later. `north`, `east` are velocities over ground. An accelerometer's axes
are the unit's own: how it is mounted is found from the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from can_dbc.units import UNITS
from estimator.drive_log.bag.layout import Columns
from hil_gateway.car.actuation import PRESSED
from hil_gateway.process.arrays import Array
from hil_gateway.session.drive_table import VY_STD

KMH, DEGREE, KPA, PERCENT, RPM = (UNITS[unit].factor for unit in ("km/h", "deg", "kPa", "%", "rpm"))
INS_USABLE = (3, 6, 7)
"""INS_SOLUTION_GOOD, INS_SOLUTION_FREE, INS_ALIGNMENT_COMPLETE of NovAtel"""
VY_VARIANCE = "twist.covariance[7]"
"""of a filter that states it"""
STEERING_MOTOR = "steering_motor"
"""rad; becomes `steer` by the ratio of the car"""
COMPUTED = 0
"""SOL_COMPUTED of NovAtel"""
Quantities = Mapping[str, Array]


@dataclass(frozen=True)
class Message:
    """One kind: what it says, how that was converted, and its rank among sources of the same (0: first)."""

    quantities: Callable[[Columns], Quantities]
    rank: int
    said: str = ""
    stamp: str = "header.stamp"


def _imu(m: Columns) -> Quantities:
    motion = {f"a{axis}": m[f"linear_acceleration.{axis}"] for axis in "xyz"}
    return motion | {"yaw_rate": m["angular_velocity.z"]}


def _odometry(m: Columns) -> Quantities:
    place = {axis: m[f"pose.pose.position.{axis}"] for axis in "xyz"}
    if np.ptp(place["z"]) == 0.0:  # of an estimator in the plane
        del place["z"]
    motion = {"vx": m["twist.twist.linear.x"], "vy": m["twist.twist.linear.y"]}
    if (m[VY_VARIANCE] > 0.0).any():
        motion[VY_STD] = np.sqrt(np.maximum(m[VY_VARIANCE], 0.0))
    return place | motion | {"yaw": _yaw(m, "pose.pose.orientation"), "yaw_rate": m["twist.twist.angular.z"]}


def _yaw(m: Columns, path: str) -> Array:
    x, y, z, w = (m[f"{path}.{axis}"] for axis in "xyzw")
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _fix(m: Columns) -> Quantities:
    there = m["status.status"] >= 0
    return _only(there, {"latitude": m["latitude"], "longitude": m["longitude"], "z": m["altitude"]})


def _twist(m: Columns) -> Quantities:
    return {"vx": m["twist.linear.x"], "vy": m["twist.linear.y"], "yaw_rate": m["twist.angular.z"]}


def _covariant_twist(m: Columns) -> Quantities:
    names = {"vx": "linear.x", "vy": "linear.y", "yaw_rate": "angular.z"}
    return {name: m[f"twist.twist.{path}"] for name, path in names.items()}


def _best_position(m: Columns) -> Quantities:
    there = m["sol_status.status"] == COMPUTED
    return _only(there, {"latitude": m["lat"], "longitude": m["lon"], "z": m["hgt"]})


def _best_velocity(m: Columns) -> Quantities:
    course, speed = m["trk_gnd"] * DEGREE, m["hor_speed"]
    there = m["sol_status.status"] == COMPUTED
    return _only(there, {"north": speed * np.cos(course), "east": speed * np.sin(course)})


def _inertial(status: str) -> Callable[[Columns], Quantities]:
    def quantities(m: Columns) -> Quantities:
        motion = {"north": m["north_velocity"], "east": m["east_velocity"], "yaw": (90.0 - m["azimuth"]) * DEGREE}
        place = {"latitude": m["latitude"], "longitude": m["longitude"], "z": m["height"]}
        return _only(np.isin(m[status], INS_USABLE), motion | place)

    return quantities


def _only(there: NDArray[np.bool_], quantities: Quantities) -> Quantities:
    return {name: np.where(there, values, np.nan) for name, values in quantities.items()}


def _corrected_imu(m: Columns) -> Quantities:
    """Sums over the step to the message before, gravity taken out; x of the unit points to its right, y forward."""
    step_s = float(np.median(np.diff(m["nov_header.gps_week_milliseconds"]))) / 1e3
    names = {"ax": "lateral_acc", "ay": "longitudinal_acc", "yaw_rate": "yaw_rate"}
    return {name: m[path] / step_s for name, path in names.items()}


def _vectornav(m: Columns) -> Quantities:
    motion = {"north": m["velocity.x"], "east": m["velocity.y"], "yaw": (90.0 - m["yawpitchroll.x"]) * DEGREE}
    forces = {f"a{axis}": m[f"accel.{axis}"] for axis in "xyz"} | {"yaw_rate": m["angularrate.z"]}
    return motion | forces | {"latitude": m["position.x"], "longitude": m["position.y"], "z": m["position.z"]}


def _vectornav_ins(m: Columns) -> Quantities:
    return {"north": m["velned.x"], "east": m["velned.y"], "latitude": m["poslla.x"], "longitude": m["poslla.y"]}


def _wheels(m: Columns) -> Quantities:
    names = {"fl": "front_left", "fr": "front_right", "rl": "rear_left", "rr": "rear_right"}
    return {f"wheel_speed_{wheel}": KMH * m[name] for wheel, name in names.items()}


def _steering(path: str) -> Callable[[Columns], Quantities]:
    return lambda m: {STEERING_MOTOR: m[path] * DEGREE}


def _brakes(m: Columns) -> Quantities:
    front, rear = KPA * m["front_brake_pressure"], KPA * m["rear_brake_pressure"]
    return {"brake": (front + rear) / 2, "brake_balance": (front - rear) / np.maximum(front + rear, PRESSED)}


def _engine(m: Columns) -> Quantities:
    return {"engine_speed": m["engine_rpm"] * RPM, "gear": m["current_gear"]}


def _simulator(m: Columns) -> Quantities:
    names = {"fl": "front_left", "fr": "front_right", "rl": "rear_left", "rr": "rear_right"}
    speeds = {f"wheel_speed_{wheel}": KMH * m[f"ws_{name}"] for wheel, name in names.items()}
    pedal = {"throttle": PERCENT * m["accel_pedal_output"]}
    return {**speeds, **pedal, **_brakes(m), **_steering("steering_wheel_angle")(m)}


_STEERED = "motor angle in deg, over the steering ratio of the car ([steer] ratio in a map is on top of it)"
_CLOCKWISE = "heading counted from north clockwise: turned into yaw from east"
MESSAGES: Mapping[str, Message] = {
    "sensor_msgs/msg/Imu": Message(_imu, 0),
    "novatel_oem7_msgs/msg/RAWIMU": Message(_imu, 1),
    "novatel_oem7_msgs/msg/CORRIMU": Message(_corrected_imu, 3, "sums: divided by their step"),
    "novatel_oem7_msgs/msg/IMURATECORRIMU": Message(_corrected_imu, 3, "sums: divided by their step"),
    "novatel_oem7_msgs/msg/INSPVA": Message(_inertial("status.status"), 0, _CLOCKWISE),
    "novatel_oem7_msgs/msg/INSPVAX": Message(_inertial("ins_status.status"), 1, _CLOCKWISE),
    "nav_msgs/msg/Odometry": Message(_odometry, 2),
    "vectornav_msgs/msg/CommonGroup": Message(_vectornav, 2, _CLOCKWISE),
    "vectornav_msgs/msg/InsGroup": Message(_vectornav_ins, 4),
    "geometry_msgs/msg/TwistStamped": Message(_twist, 5),
    "geometry_msgs/msg/TwistWithCovarianceStamped": Message(_covariant_twist, 5),
    "novatel_oem7_msgs/msg/BESTPOS": Message(_best_position, 3),
    "novatel_oem7_msgs/msg/BESTVEL": Message(_best_velocity, 3),
    "sensor_msgs/msg/NavSatFix": Message(_fix, 4),
    "raptor_dbw_msgs/msg/WheelSpeedReport": Message(_wheels, 0, "km/h, whatever the definition says"),
    "raptor_dbw_msgs/msg/SteeringReport": Message(_steering("steering_wheel_angle"), 0, _STEERED),
    "raptor_dbw_msgs/msg/Brake2Report": Message(_brakes, 0, "kPa, whatever the definition says"),
    "raptor_dbw_msgs/msg/AcceleratorPedalReport": Message(lambda m: {"throttle": PERCENT * m["pedal_output"]}, 0, "%"),
    "deep_orange_msgs/msg/PtReport": Message(_engine, 0, "rpm", stamp="stamp"),
    "autonoma_msgs/msg/VehicleData": Message(_simulator, 1, f"km/h, kPa, %; {_STEERED}"),
    "autonoma_msgs/msg/PowertrainData": Message(_engine, 1, "rpm"),
    "ackermann_msgs/msg/AckermannDriveStamped": Message(lambda m: {"steer": m["drive.steering_angle"]}, 9, "a command"),
}
"""kind -> what it says"""


def kinds() -> Sequence[str]:
    """Message kinds, also as old bags write them."""
    return [*MESSAGES, *(kind.replace("/msg/", "/") for kind in MESSAGES)]
