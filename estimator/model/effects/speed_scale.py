"""Speed scale: the reported forward speed is off by a factor (tyre radius, slip of the measuring wheel)."""

from __future__ import annotations

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr


def _input(terms: Terms, scale: Expr) -> None:
    terms.vx = terms.vx / scale


def _sensor(terms: Terms, scale: Expr) -> None:
    terms.vx_dot = scale * terms.vx_dot


EFFECT = Effect(
    name="speed_scale",
    lacks="reported speed is off by a factor",
    equation="v_x,reported = k v_x",
    source="definition",
    parameters=(Parameter("scale", "1", 1.0, 0.05, 0.5, 2.0, "reported over true forward speed"),),
    channels=("vx_dot", "vy_dot", "ay", "yaw_acc"),
    hooks={"INPUT": _input, "SENSOR": _sensor},
    separated_by="v_x times yaw rate against a_y in long corners; position against the integral of speed",
)
