"""Prediction error of the vehicle model before and after a drive, measured by the estimator's own command.

The command line is the seam: this package may not import the estimator.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil_gateway.demo.folder import CONFIG_NAME

TIMEOUT_S = 120.0
FIGURE = "position"
"""channel that stands for the others: m after one second of open-loop prediction"""


@dataclass(frozen=True)
class Answer:
    """What a command of the project said: its JSON, or why there is none."""

    content: dict[str, Any]
    reason: str = ""


def ask(arguments: Sequence[str], timeout_s: float) -> Answer:
    """Run `hil ARGUMENTS --json`; a failure becomes a reason. On a terminal its progress shows."""
    command = [sys.executable, "-m", "hil_gateway", *arguments, "--json"]
    try:
        stderr = None if sys.stderr.isatty() else subprocess.PIPE
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, text=True, timeout=timeout_s, check=False)
    except subprocess.TimeoutExpired:
        return Answer({}, f"`hil {arguments[0]}` took longer than {timeout_s:g} s")
    if done.returncode != 0:
        lines = (done.stderr or "").strip().splitlines()
        return Answer({}, lines[-1].removeprefix("hil: ") if lines else f"`hil {arguments[0]}` failed")
    return Answer(json.loads(done.stdout))


def measure(session: Path, models: tuple[Path, Path] | None = None) -> dict[str, Any]:
    """`before` and `after`, m, on the session of a drive; null with a `reason` where they could not be measured.

    Without `models`: the revision the session began with and the one it had learnt, on its last third. With: these
    two, on the whole session.
    """
    arguments = ["estimator", "score", str(session), "--config", str(session.with_name(CONFIG_NAME))]
    if models:
        arguments += ["--before", str(models[0]), "--after", str(models[1])]
    answer = ask(arguments, TIMEOUT_S)
    if answer.reason:
        return unknown(answer.reason)
    score = answer.content
    part = "a session neither model has learnt from" if models else "last third of the session"
    return {
        "before": score["before"][FIGURE],
        "after": score["after"][FIGURE],
        "unit": f"m, position after {score['horizon_s']:g} s of open-loop prediction, {part}",
        "channels": {
            name: {"before": score["before"][name], "after": score["after"][name]} for name in score["before"]
        },
        "revisions": score["revisions"],
        "windows": score["windows"],
    }


def unknown(reason: str) -> dict[str, Any]:
    """The result where nothing could be measured."""
    return {"before": None, "after": None, "reason": reason}
