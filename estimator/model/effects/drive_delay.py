"""Drive delay: the true actuation lags the reported one.

On recorded data the reported signal is shifted; without a past, u(t - T) is replaced by u - T du/dt, right
to first order in T.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effects.base import Array, Effect
from estimator.model.memory import delayed
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr
from hil_gateway.vehicle import Vehicle


def _input(terms: Terms, delay: Expr) -> None:
    first_order = -delay * terms.auxiliary("drive_rate")
    terms.drive = terms.drive + terms.aux.get("drive_shift", first_order)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    return {"drive_shift": delayed(signals["t"], signals["drive"], parameters[0]) - signals["drive"]}


EFFECT = Effect(
    name="drive_delay",
    lacks="true drive command lags the reported one",
    equation="d(t) = d_reported(t - T)",
    source="definition; first-order form by Taylor expansion",
    parameters=(Parameter("delay", "s", 0.0, 0.05, 0.0, 0.5, "true actuation after the reported one"),),
    channels=("ax", "vx_dot"),
    hooks={"INPUT": _input},
    prepare=_prepare,
    initial=(0.05,),
    remembers=("drive_shift",),
    separated_by="fast changes of throttle or brake",
)
