"""Steps of a drive as they were given to the solver: the same QPs for every solver that is compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.plans.bench import drive
from hil_gateway.process.errors import InputError
from planner.plan.controller import Controller
from planner.solver.sqp import Step


def record(controller: Controller, steps: int) -> list[Step]:
    """The steps of a drive on the controller's own model, after the cold start."""
    found: list[Step] = []
    controller.sqp.observer = found.append
    drive(controller, 1, steps=steps)
    controller.sqp.observer = None
    return found[-steps:]


def save(path: Path, steps: Sequence[Step]) -> None:
    """Write steps as one array a field (numpy, compressed)."""
    columns: dict[str, Any] = {f.name: np.array([getattr(s, f.name) for s in steps]) for f in fields(Step)}
    np.savez_compressed(path, **columns)


def load(path: Path) -> list[Step]:
    """Read what `save` wrote.

    Raises:
        InputError: not such a file.
    """
    try:
        with np.load(path) as stored:
            columns = {f.name: stored[f.name] for f in fields(Step)}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: not a file of recorded steps ({error}); record one with --record") from None
    arrays = [f.name for f in fields(Step) if f.name != "iterations"]
    rows = zip(columns["iterations"], *(columns[name] for name in arrays), strict=True)
    return [Step(**dict(zip(arrays, map(np.asfortranarray, row), strict=True)), iterations=int(n)) for n, *row in rows]
