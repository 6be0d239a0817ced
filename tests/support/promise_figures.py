"""Where the tests of promises write down what they proved: figures by `record_figure`, outcomes by the hooks below."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

FIGURES_VARIABLE = "HIL_PROMISE_FIGURES"
"""Environment variable with the file the lines are appended to, one JSON object each."""

LONG_VARIABLE = "HIL_LONG"
"""Set by `hil verify --long`."""

SHARE_VARIABLE = "HIL_SHARE"
"""Share of the usual volume, for runs that repeat a test very often (mutation)."""

ONLY_VARIABLE = "HIL_PROMISES"
"""Comma-separated promises to run; empty: all."""


def record_figure(promise: str, figure: str, *, missed: bool = False) -> None:
    """Write down what a test of `promise` reached; `missed` where that is less than the promise requires."""
    _write({"promise": promise, "figure": figure, "missed": missed})


def long_run() -> bool:
    """Whether this is `hil verify --long`."""
    return bool(os.environ.get(LONG_VARIABLE))


def volume(usual: int, long: int) -> int:
    """How much a test does: `usual` in CI, `long` under `hil verify --long`."""
    if long_run():
        return long
    return max(1, int(usual * float(os.environ.get(SHARE_VARIABLE, "1"))))


def note_outcome(item: Any, report: Any) -> None:
    """One line for every promise a finished test is marked with."""
    if report.when == "call" or (report.when == "setup" and not report.passed):
        for marker in item.iter_markers("promise"):
            _write({"promise": marker.args[0], "test": item.nodeid, "outcome": report.outcome})


def select(items: list[Any]) -> list[Any]:
    """The tests of the promises asked for; everything when none is."""
    wanted = {part for part in os.environ.get(ONLY_VARIABLE, "").split(",") if part}
    if not wanted:
        return items
    return [item for item in items if wanted & {marker.args[0] for marker in item.iter_markers("promise")}]


def _write(entry: dict[str, str | bool]) -> None:
    target = os.environ.get(FIGURES_VARIABLE)
    if target:
        with Path(target).open("a") as file:
            file.write(json.dumps(entry) + "\n")
