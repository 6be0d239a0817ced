"""Wheels that swing about their steering axis: they lag as behind a delay, which is not to be named for it.

It is outside the catalogue: what is found is told as unexplained, with its period. The wheels overshoot the reported
angle, which neither a delay nor a first-order lag does.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effect import Effect
from estimator.model.effects.steer_delay import EFFECT as STEER_DELAY
from estimator.model.memory import followed, swung
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr


def _input(terms: Terms, period: Expr, damping: Expr) -> None:
    terms.steer = terms.steer + terms.aux.get("steer_swing", 0.0 * period * damping)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    asked = followed(signals, "steer")
    return {"steer_swing": swung(signals["t"], asked, *parameters) - asked}


STEER_SWING = Effect(
    name="steer_swing",
    form_of=STEER_DELAY,
    lacks="the wheels swing about their steering axis",
    equation="(T / 2 pi)^2 delta'' + 2 zeta T / 2 pi delta' + delta = delta_reported",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 6 (steering system with one degree of freedom)",
    parameters=(
        Parameter(
            "period",
            "s",
            0.0,
            0.2,
            0.0,
            0.8,
            "natural period T",
            Plausible(0.08, 0.33, "wheels on the compliance of a rack: 3 to 12 Hz; slower, it is the car that yaws"),
        ),
        Parameter(
            "damping",
            "1",
            0.3,
            0.3,
            0.01,
            0.6,
            "damping ratio zeta",
            Plausible(0.08, 0.5, "below, wheels shimmy at any bump; above, they overshoot by less than a sixth"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer",
    hooks={"INPUT": _input},
    prepare=_prepare,
    initial=(0.2, 0.3),
    remembers=("steer_swing",),
    separated_by="quick steering: the wheels overshoot and ring",
)
