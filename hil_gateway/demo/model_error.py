"""Prediction error of the vehicle model before and after a drive, measured by the estimator's own command.

The command line is the seam: this package may not import the estimator.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hil_gateway.demo.folder import CONFIG_NAME
from hil_gateway.process.own_command import ask

FIGURE = "position"
"""channel that stands for the others: m after one second of open-loop prediction"""


def measure(session: Path) -> dict[str, Any]:
    """`before` and `after`, m, on the session of a drive; null with a `reason` where they could not be measured.

    The revision the session began with and the one it had learnt, on its last third.
    """
    arguments = ["estimator", "score", str(session), "--config", str(session.with_name(CONFIG_NAME))]
    answer = ask(arguments)
    if answer.reason:
        return unknown(answer.reason)
    score = answer.content
    return {
        "before": score["before"][FIGURE],
        "after": score["after"][FIGURE],
        "unit": f"m, position after {score['horizon_s']:g} s of open-loop prediction, last third of the session",
        "channels": {
            name: {"before": score["before"][name], "after": score["after"][name]} for name in score["before"]
        },
        "revisions": score["revisions"],
        "windows": score["windows"],
    }


def unknown(reason: str) -> dict[str, Any]:
    """The result where nothing could be measured."""
    return {"before": None, "after": None, "reason": reason}
