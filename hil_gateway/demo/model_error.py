"""Prediction error of the vehicle model before and after the drive, measured by the estimator's own command.

The command line is the seam: this package may not import the estimator.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

from hil_gateway.demo.options import DemoSetup

TIMEOUT_S = 120.0
FIGURE = "position"
"""channel that stands for the others: m after one second of open-loop prediction"""


def measure(setup: DemoSetup) -> dict[str, Any]:
    """`before` and `after`: error on the last third of the session, m; null with a `reason` where it has none."""
    command = [sys.executable, "-m", "hil_gateway.cli", "estimator", "score", str(setup.session)]
    command += ["--config", str(setup.config_file), "--json"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return unknown(f"`hil estimator score` took longer than {TIMEOUT_S:g} s")
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        return unknown(lines[-1].removeprefix("hil: ") if lines else "`hil estimator score` failed")
    score = json.loads(done.stdout)
    return {
        "before": score["before"][FIGURE],
        "after": score["after"][FIGURE],
        "unit": "m, position after 1 s of open-loop prediction, last third of the session",
        "channels": {
            name: {"before": score["before"][name], "after": score["after"][name]} for name in score["before"]
        },
        "revisions": score["revisions"],
        "windows": score["windows"],
    }


def unknown(reason: str) -> dict[str, Any]:
    """The result where nothing could be measured."""
    return {"before": None, "after": None, "reason": reason}
