"""IMU lever arm: the accelerometer does not sit at the centre of gravity."""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _sensor(terms: Terms, x: Expr, y: Expr) -> None:
    square = terms.yaw_rate * terms.yaw_rate
    terms.imu_ax = terms.imu_ax - terms.yaw_acc * y - square * x
    terms.imu_ay = terms.imu_ay + terms.yaw_acc * x - square * y


EFFECT = Effect(
    name="imu_lever_arm",
    lacks="accelerometer away from the centre of gravity",
    equation="a_imu = a + dw/dt x r + w x (w x r)",
    source="Goldstein, Classical Mechanics, ch. 4 (acceleration in a rotating frame)",
    parameters=(
        Parameter(
            "x",
            "m",
            0.0,
            0.3,
            -5.0,
            5.0,
            "sensor ahead of the centre of gravity",
            Plausible(-3.5, 3.5, "inside the car; a centre of gravity is known to 0.1 m", 0.1),
            quantity=Quantity.ACCELEROMETER_AHEAD,
        ),
        Parameter(
            "y",
            "m",
            0.0,
            0.3,
            -3.0,
            3.0,
            "sensor to the left of the centre of gravity",
            Plausible(-1.5, 1.5, "inside the car; the middle of a car is known to 0.05 m", 0.05),
        ),
    ),
    channels=("ax", "ay"),
    cause="yaw_rate",
    hooks={"SENSOR": _sensor},
    separated_by="tight corners and quick turn-in; shows in ax and ay and not in d/dt vx, d/dt vy",
)
