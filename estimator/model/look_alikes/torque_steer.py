"""Wheels that the drive turns: at a steady drive they are off by a constant, as a steering offset is."""

from __future__ import annotations

from estimator.model.effect import Effect, braking_part
from estimator.model.effects.steer_offset import EFFECT as STEER_OFFSET
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _input(terms: Terms, pushing: Expr, braking: Expr) -> None:
    negative = braking_part(terms.drive)
    terms.steer = terms.steer + pushing * (terms.drive - negative) + braking * negative


_OFF = Plausible(-0.3, 0.3, "a degree at the largest force", 0.01)
TORQUE_STEER = Effect(
    name="torque_steer",
    form_of=STEER_OFFSET,
    lacks="drive or brakes turn the wheels",
    equation="delta = delta_reported + k max(d, 0) + k_b min(d, 0)",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 8 (torque steer, brake steer)",
    parameters=(
        Parameter("pushing", "rad", 0.0, 0.05, -1.0, 1.0, "angle per slip command, driving", _OFF),
        Parameter("braking", "rad", 0.0, 0.05, -1.0, 1.0, "angle per slip command, braking", _OFF),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="drive",
    hooks={"INPUT": _input},
    separated_by="power on and off, and braking, on a straight",
)
