"""Play in the steering: the wheels follow the reported angle only once it has crossed the gap.

On recorded data the angle of the wheels is what the gap has left of the past; without a past it is left out: half a
gap is below what a driver or a controller holds.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effect import Effect
from estimator.model.memory import after_play, followed
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr


def _input(terms: Terms, gap: Expr) -> None:
    terms.steer = terms.steer + terms.aux.get("steer_lost", 0.0 * gap)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    asked = followed(signals, "steer")
    return {"steer_lost": after_play(asked, parameters[0]) - asked}


EFFECT = Effect(
    name="steer_play",
    lacks="play or friction between the reported angle and the wheels (hysteresis)",
    equation="delta = min(max(delta_before, delta_reported - b / 2), delta_reported + b / 2)",
    source="Prandtl's play operator (Brokate & Sprekels, Hysteresis and Phase Transitions, ch. 2)",
    parameters=(
        Parameter(
            "gap",
            "rad",
            0.0,
            0.005,
            0.0,
            0.06,
            "gap b, at the wheels: how far the reported angle turns back before they follow",
            Plausible(
                0.0,
                0.05,
                "3 deg at the wheels is half a turn of a steering wheel; a sound rack has below 1 mrad",
                0.001,
            ),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer_rate",
    hooks={"INPUT": _input},
    prepare=_prepare,
    initial=(0.003,),
    remembers=("steer_lost",),
    separated_by="small and large reversals of the steering: a delay grows with its rate, a gap does not",
)
