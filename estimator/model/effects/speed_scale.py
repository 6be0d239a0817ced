"""Speed scale: the reported speed is off by a factor (tyre radius, slip of the measuring wheel, optical sensor)."""

from __future__ import annotations

from estimator.model.effect import ESTIMATED, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _input(terms: Terms, scale: Expr, lateral: Expr) -> None:
    terms.vx, terms.vy = terms.vx / scale, terms.vy / lateral


def _sensor(terms: Terms, scale: Expr, lateral: Expr) -> None:
    terms.vx_dot, terms.vy_dot = scale * terms.vx_dot, lateral * terms.vy_dot


EFFECT = Effect(
    name="speed_scale",
    lacks="reported speed is off by a factor",
    equation="v_x,reported = k v_x, v_y,reported = k_y v_y",
    source="definition",
    parameters=(
        Parameter(
            "scale",
            "1",
            1.0,
            0.05,
            0.5,
            2.0,
            "reported over true forward speed",
            Plausible(0.85, 1.15, "rolling radius, growth at speed and slip of a wheel stay below 15 %"),
            quantity=Quantity.SPEED_SCALE,
        ),
        Parameter(
            "lateral",
            "1",
            1.0,
            0.05,
            0.5,
            2.0,
            "reported over true lateral velocity",
            Plausible(0.7, 1.4, "optical sensors and filters are off by far less"),
        ),
    ),
    channels=("vx_dot", "vy_dot", "ay", "yaw_acc"),
    cause="yaw_rate",
    hooks={"INPUT": _input, "SENSOR": _sensor},
    unsought_while_driving=ESTIMATED,
    separated_by="v_x times yaw rate against a_y in long corners; position against the integral of speed",
)
