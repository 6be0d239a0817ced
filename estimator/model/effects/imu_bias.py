"""IMU bias: constant errors of the accelerometer."""

from __future__ import annotations

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr


def _sensor(terms: Terms, ax: Expr, ay: Expr) -> None:
    terms.imu_ax = terms.imu_ax + ax
    terms.imu_ay = terms.imu_ay + ay


EFFECT = Effect(
    name="imu_bias",
    lacks="constant errors of the accelerometer",
    equation="a_imu = a + b",
    source="IEEE Std 1293 (linear accelerometers), bias",
    parameters=(
        Parameter("ax", "m/s2", 0.0, 0.2, -5.0, 5.0, "bias of the longitudinal accelerometer"),
        Parameter("ay", "m/s2", 0.0, 0.2, -5.0, 5.0, "bias of the lateral accelerometer"),
    ),
    channels=("ax", "ay"),
    hooks={"SENSOR": _sensor},
    separated_by="shows in ax and ay and not in d/dt vx, d/dt vy",
)
