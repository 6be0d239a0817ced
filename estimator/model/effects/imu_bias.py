"""IMU bias: constant errors of accelerometer and gyroscope."""

from __future__ import annotations

from estimator.model.effect import ESTIMATED, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _input(terms: Terms, ax: Expr, ay: Expr, yaw_rate: Expr) -> None:
    terms.yaw_rate = terms.yaw_rate - yaw_rate


def _sensor(terms: Terms, ax: Expr, ay: Expr, yaw_rate: Expr) -> None:
    terms.imu_ax = terms.imu_ax + ax
    terms.imu_ay = terms.imu_ay + ay


EFFECT = Effect(
    name="imu_bias",
    lacks="constant errors of accelerometer and gyroscope",
    equation="a_imu = a + b, w_imu = w + b_w",
    source="IEEE Std 1293 (linear accelerometers), bias; IEEE Std 952 (gyroscopes)",
    parameters=(
        Parameter(
            "ax",
            "m/s2",
            0.0,
            0.2,
            -5.0,
            5.0,
            "bias of the longitudinal accelerometer",
            Plausible(-2.0, 2.0, "0.2 g is ten times a cheap sensor's zero; 5 mg is what zeroing leaves", 0.05),
        ),
        Parameter(
            "ay",
            "m/s2",
            0.0,
            0.2,
            -5.0,
            5.0,
            "bias of the lateral accelerometer",
            Plausible(-2.0, 2.0, "0.2 g is ten times a cheap sensor's zero; 5 mg is what zeroing leaves", 0.05),
            quantity=Quantity.LATERAL_ZERO,
        ),
        Parameter(
            "yaw_rate",
            "rad/s",
            0.0,
            0.01,
            -0.2,
            0.2,
            "bias of the yaw-rate gyroscope",
            Plausible(
                -0.08, 0.08, "5 deg/s is ten times a cheap sensor's zero; 0.1 deg/s is what zeroing leaves", 0.0018
            ),
            quantity=Quantity.GYROSCOPE_ZERO,
        ),
    ),
    channels=("ax", "ay", "vy_dot"),
    cause="t",
    hooks={"INPUT": _input, "SENSOR": _sensor},
    estimated_by_filter=True,
    unsought_while_driving=ESTIMATED,
    separated_by="accelerometer: shows in ax, ay and not in d/dt vx, d/dt vy; gyroscope: the rate on straights",
)
