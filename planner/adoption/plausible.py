"""Which model revisions are taken for faults, and not driven with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.model.effects import catalogue
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.process.arrays import Array

PLAUSIBLE = 2.5
"""factor between tyre parameters beyond which a revision or a belief is taken for a fault"""


def implausible(revision: ModelRevision, start: ModelRevision) -> str:
    """Why a revision must not be driven with, given the one the run started from; empty when it may."""
    if revision.layout != start.layout:
        return f"layout {revision.layout} is not the planner's {start.layout}"
    if unknown := [e.name for e in revision.effects if e.name not in catalogue()]:
        return f"effect {unknown[0]} is unknown"
    if revision.tyre.keys() != start.tyre.keys():
        odd = sorted(revision.tyre.keys() ^ start.tyre.keys())[0]
        return f"tyre parameter {odd} is missing or unknown; layout {start.layout} has {', '.join(start.tyre)}"
    for name, value in revision.tyre.items():
        if not near((value,), (start.tyre[name],)):
            return f"tyre parameter {name} = {value:.4g} is far from the {start.tyre[name]:.4g} the run started with"
    return ""


def near(values: Sequence[float], references: Sequence[float] | Array) -> bool:
    """Whether all values are finite and within a factor `PLAUSIBLE` of their positive references."""
    ratios = np.asarray(values) / np.asarray(references)
    return bool(np.all(np.isfinite(ratios)) and np.all((ratios < PLAUSIBLE) & (ratios > 1 / PLAUSIBLE)))
