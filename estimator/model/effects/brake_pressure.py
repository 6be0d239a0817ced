"""Brake pressure: braking at the front axle follows the brake and not the reported slip-ratio command.

A slip-ratio command measured at the driven wheels knows nothing of what the brakes do to the others.
"""

from __future__ import annotations

from estimator.model.effect import NO_BRAKES_AHEAD, Effect
from estimator.model.effects.front_brake import EFFECT as FRONT_BRAKE
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _longitudinal(terms: Terms, force: Expr) -> None:
    terms.fx_f = terms.fx_f - force * terms.auxiliary("brake")


EFFECT = Effect(
    name="brake_pressure",
    lacks="braking force of the front axle that the drive command does not report",
    equation="F_x,f = -F_b p, p the brake, 0..1 (1: 6 MPa or pedal down)",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 3 (brake gain)",
    parameters=(
        Parameter(
            "force",
            "N",
            0.0,
            3000.0,
            0.0,
            60000.0,
            "braking force at full brake",
            Plausible(0.0, 40000.0, "3 g of a 1300 kg car"),
        ),
    ),
    channels=("ax", "ay", "yaw_acc", "vx_dot", "vy_dot"),
    cause="brake",
    hooks={"LONGITUDINAL": _longitudinal},
    needs=("brake",),
    form_of=FRONT_BRAKE,
    unsought_while_driving=NO_BRAKES_AHEAD,
    on_every_car=True,
    separated_by="braking at equal drive command and different brake pressure",
)
