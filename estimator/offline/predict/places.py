"""Where an empirical term can act on the model: on a force, a moment, the grip, an input, the motion, a sensor.

Places that multiply what the tyre, the driver or the air does make a term of one signal depend on two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from estimator.model.effect import Effect, braking_part
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr


@dataclass(frozen=True)
class TermPlace:
    """Where an empirical term acts.

    A term without its signal would be a constant effect (`Effect.constant_at`): `constant_per_unit` of a vehicle is the
    size of that for one unit of the term.
    """

    stage: str
    hook: Callable[..., None]
    unit: str
    std: float
    channels: tuple[str, ...]
    words: str
    constant_per_unit: Callable[[Vehicle], float] = lambda _: 1.0


def _force_x(terms: Terms, value: Expr) -> None:
    terms.body_x = terms.body_x + terms.vehicle.mass * value


def _air_force(terms: Terms, value: Expr) -> None:
    terms.body_x = terms.body_x + value * terms.vx * terms.vx


def _force_y(terms: Terms, value: Expr) -> None:
    terms.body_y = terms.body_y + terms.vehicle.mass * value


def _moment(terms: Terms, value: Expr) -> None:
    terms.body_yaw = terms.body_yaw + terms.vehicle.yaw_inertia * value


def _damping(terms: Terms, value: Expr) -> None:
    terms.body_yaw = terms.body_yaw - terms.vehicle.yaw_inertia * value * terms.yaw_rate


def _grip(terms: Terms, value: Expr) -> None:
    terms.grip_f, terms.grip_r = terms.grip_f * (1 + value), terms.grip_r * (1 + value)


def _grip_front(terms: Terms, value: Expr) -> None:
    terms.grip_f = terms.grip_f * (1 + value)


def _grip_rear(terms: Terms, value: Expr) -> None:
    terms.grip_r = terms.grip_r * (1 + value)


def _steer(terms: Terms, value: Expr) -> None:
    terms.steer = terms.steer + value


def _steer_gain(terms: Terms, value: Expr) -> None:
    terms.steer = terms.steer * (1 + value)


def _power_gain(terms: Terms, value: Expr) -> None:
    terms.drive = terms.drive + value * (terms.drive - braking_part(terms.drive))


def _brake_gain(terms: Terms, value: Expr) -> None:
    terms.drive = terms.drive + value * braking_part(terms.drive)


def _motion_x(terms: Terms, value: Expr) -> None:
    terms.gravity_x = terms.gravity_x + value


def _motion_y(terms: Terms, value: Expr) -> None:
    terms.gravity_y = terms.gravity_y + value


def _sensor_x(terms: Terms, value: Expr) -> None:
    terms.imu_ax = terms.imu_ax + value


def _sensor_y(terms: Terms, value: Expr) -> None:
    terms.imu_ay = terms.imu_ay + value


def _sensor_y_gain(terms: Terms, value: Expr) -> None:
    terms.imu_ay = terms.imu_ay * (1 + value)


def _gyro(terms: Terms, value: Expr) -> None:
    terms.yaw_rate = terms.yaw_rate - value


LATERAL, FORWARD = ("ay", "yaw_acc", "vy_dot"), ("ax", "vx_dot")
PLACES = {
    "force_x": TermPlace(
        "LONGITUDINAL", _force_x, "m/s2", 0.5, FORWARD, "longitudinal force", lambda v: -v.mass
    ),
    "air_force": TermPlace(
        "LONGITUDINAL", _air_force, "N s2/m2", 0.3, FORWARD, "longitudinal force by speed squared",
        lambda _: -1.0,
    ),
    "force_y": TermPlace("BODY", _force_y, "m/s2", 0.5, ("ay", "vy_dot"), "lateral force"),
    "moment": TermPlace("BODY", _moment, "rad/s2", 0.3, ("yaw_acc",), "yaw moment"),
    "damping": TermPlace("BODY", _damping, "1/s", 1.0, ("yaw_acc",), "yaw moment by yaw rate"),
    "grip": TermPlace("GRIP", _grip, "1", 0.1, LATERAL, "tyre grip of both axles"),
    "grip_front": TermPlace("GRIP", _grip_front, "1", 0.1, LATERAL, "tyre grip of the front axle"),
    "grip_rear": TermPlace("GRIP", _grip_rear, "1", 0.1, LATERAL, "tyre grip of the rear axle"),
    "steer": TermPlace("INPUT", _steer, "rad", 0.005, LATERAL, "road-wheel angle"),
    "steer_gain": TermPlace("INPUT", _steer_gain, "1", 0.1, LATERAL, "gain of the steering"),
    "power_gain": TermPlace("INPUT", _power_gain, "1", 0.1, FORWARD, "gain of the drive command, driving"),
    "brake_gain": TermPlace("INPUT", _brake_gain, "1", 0.1, FORWARD, "gain of the drive command, braking"),
    "motion_x": TermPlace("MOTION", _motion_x, "m/s2", 0.3, ("vx_dot",), "longitudinal motion, not felt in ax"),
    "motion_y": TermPlace("MOTION", _motion_y, "m/s2", 0.3, ("vy_dot",), "lateral motion, not felt in ay"),
    "gyro": TermPlace("INPUT", _gyro, "rad/s", 0.01, LATERAL, "gyroscope alone"),
    "sensor_x": TermPlace("SENSOR", _sensor_x, "m/s2", 0.3, ("ax",), "longitudinal accelerometer alone"),
    "sensor_y": TermPlace("SENSOR", _sensor_y, "m/s2", 0.3, ("ay",), "lateral accelerometer alone"),
    "sensor_y_gain": TermPlace("SENSOR", _sensor_y_gain, "1", 0.1, ("ay",), "gain of the lateral accelerometer"),
}  # fmt: skip


def term_effect(place: str, signal: str) -> Effect:
    """The empirical term as an effect; its profile is stored under its own name (knots are its own)."""
    p = PLACES[place]
    name = f"empirical_{place}_{signal}"
    return Effect(
        name=name,
        lacks=f"empirical: {p.words} as a function of {signal}",
        equation=f"{place} += spline({signal})",
        source="empirical, fitted to this data",
        parameters=(Parameter("value", p.unit, 0.0, p.std, -50 * p.std, 50 * p.std, p.words),),
        channels=p.channels,
        cause=signal,
        hooks={p.stage: p.hook},
        profile=name,
    )
