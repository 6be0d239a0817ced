"""Gear shift: the engine does not pull while the gears change, whatever the pedal says.

On recorded data the gap begins where the reported gear changes; without a past no gear changes.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimator.model.effect import Effect, braking_force
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr


def _longitudinal(terms: Terms, gap: Expr) -> None:
    driving = terms.fx_r - braking_force(terms.fx_r, terms.vehicle)
    terms.fx_r = terms.fx_r - terms.aux.get("shifting", 0.0 * gap) * driving


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    """Share of each sample, until the next one, that lies in a gap."""
    t, changed = signals["t"], np.flatnonzero(np.diff(signals["gear"]) != 0) + 1
    if not len(changed):
        return {"shifting": np.zeros_like(t)}
    latest = np.searchsorted(changed, np.arange(len(t)), side="right") - 1
    since = np.where(latest < 0, np.inf, t - t[changed[np.maximum(latest, 0)]])
    return {"shifting": np.clip((parameters[0] - since) / np.gradient(t), 0.0, 1.0)}


EFFECT = Effect(
    name="gear_shift",
    lacks="no drive while the gears change",
    equation="F_x,r = C_x min(d, 0) for T after a change of gear",
    source="Guzzella & Sciarretta, Vehicle Propulsion Systems, ch. 2 (interruption of traction)",
    parameters=(
        Parameter(
            "gap",
            "s",
            0.0,
            0.05,
            0.0,
            1.0,
            "time without drive after the reported gear has changed",
            Plausible(0.0, 0.8, "dog rings 0.03 to 0.1 s, synchronised gears up to half a second"),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="gear",
    needs=("gear",),
    hooks={"LONGITUDINAL": _longitudinal},
    prepare=_prepare,
    initial=(0.06,),
    remembers=("shifting",),
    separated_by="shows for a moment at each change of gear under power, and nowhere else",
)
