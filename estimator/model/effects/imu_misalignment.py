"""IMU misalignment: the accelerometer is turned about the vertical axis."""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import ESTIMATED, Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _sensor(terms: Terms, angle: Expr) -> None:
    cos, sin = ca.cos(angle), ca.sin(angle)
    terms.imu_ax, terms.imu_ay = cos * terms.imu_ax + sin * terms.imu_ay, cos * terms.imu_ay - sin * terms.imu_ax


EFFECT = Effect(
    name="imu_misalignment",
    lacks="accelerometer turned about the vertical axis",
    equation="a_imu = R(psi)^T a",
    source="definition of a frame rotation",
    parameters=(
        Parameter(
            "angle",
            "rad",
            0.0,
            0.02,
            -0.5,
            0.5,
            "sensor axes to the left of the body axes",
            Plausible(-0.3, 0.3, "a sensor more than 17 deg off is mounted on purpose"),
        ),
    ),
    channels=("ax", "ay"),
    cause="ay",
    hooks={"SENSOR": _sensor},
    unsought_while_driving=ESTIMATED,
    separated_by="shows in ax and ay and not in d/dt vx, d/dt vy",
)
