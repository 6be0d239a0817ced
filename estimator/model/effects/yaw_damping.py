"""Yaw damping: moment against yaw, as a locked or limited-slip axle gives."""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _body(terms: Terms, k: Expr) -> None:
    terms.body_yaw = terms.body_yaw - k * terms.yaw_rate


EFFECT = Effect(
    name="yaw_damping",
    lacks="moment against yaw (locked or limited-slip axle)",
    equation="M_z = -k omega",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 5 (yaw damping)",
    parameters=(
        Parameter(
            "k",
            "N m s/rad",
            0.0,
            2000.0,
            0.0,
            30000.0,
            "moment per yaw rate",
            Plausible(
                0.0,
                20000.0,
                "a locked axle gives C_x track^2 / (2 v): 10 kN m s/rad at 5 m/s; 200 is 1 % of what axles damp",
                200.0,
            ),
        ),
    ),
    channels=("yaw_acc",),
    cause="yaw_rate",
    hooks={"BODY": _body},
    fitted_with_tyres="forces",
    separated_by="shows in the yaw acceleration and not in ay; steady tight corners",
)
