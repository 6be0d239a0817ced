"""What an identification hands on as knowledge of the tyres: only what its data determined.

An axle whose B, C and D cannot be told apart keeps the prior's shape and peak, with the cornering stiffness that was
found where that is known; else it stays at the prior. So a curve is never handed on beyond what supports it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator.model.parameters import STIFFNESS
from estimator.model.tyre import AXLES, TyreAxle, slip_at_peak
from estimator.offline.fit.identifiability import KNOWN_TO
from estimator.offline.identification import Identification

LEAST_PEAK_SLIP = math.radians(2.0)
"""Race tyres on asphalt have their peak at 3 to 8 deg; one below 2 deg is a fit to something else."""


def exported(result: Identification) -> dict[str, float]:
    """Tyre parameters of `result` as far as its data determined them, else the prior's."""
    known = result.identifiability.identifiable
    values = {"cx": result.final["cx"] if known["cx"] else result.initial["cx"]}
    for axle in AXLES[result.options.layout]:
        values |= dict(zip(axle.parameters, _curve(result, axle), strict=True))
    return values


def usable_slip(result: Identification) -> dict[str, float]:
    """Slip angle, rad, up to which each axle's exported curve rests on data (99th percentile of the log)."""
    return {axle.name: axle.slip_99 for axle in result.identifiability.axles}


def not_exported(result: Identification) -> list[str]:
    """Axles whose curve is none of a tyre, in words: something else than the tyres was fitted."""
    return [
        f"{axle.name}: B C D of {math.prod(axle.of(result.final)):.3g} is no tyre's ({STIFFNESS[0]:g} to"
        f" {STIFFNESS[1]:g} 1/rad): not exported; are units, masses and lengths right?"
        for axle in AXLES[result.options.layout]
        if _beyond(axle.of(result.final))
    ]


def _beyond(curve: Sequence[float]) -> bool:
    return not STIFFNESS[0] <= math.prod(curve) <= STIFFNESS[1]


def _curve(result: Identification, axle: TyreAxle) -> tuple[float, ...]:
    found, prior = axle.of(result.final), axle.of(result.initial)
    if all(result.identifiability.identifiable[name] for name in axle.parameters) and _tyre_like(found):
        return found
    if result.identifiability.stiffness_std[axle.name] > KNOWN_TO or _beyond(found):
        return prior
    return math.prod(found) / math.prod(prior[1:]), *prior[1:]


def _tyre_like(curve: tuple[float, ...]) -> bool:
    B, C, _ = curve
    return not _beyond(curve) and slip_at_peak(B, C) >= LEAST_PEAK_SLIP
