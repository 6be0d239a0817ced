"""Where the tests of promises write down the figure they reached."""

from __future__ import annotations

import json
import os
from pathlib import Path

FIGURES_VARIABLE = "HIL_PROMISE_FIGURES"
"""Environment variable with the file the figures are appended to, one JSON object a line."""

LONG_VARIABLE = "HIL_LONG"
"""Set by `hil verify --long`."""


def record_figure(promise: str, figure: str) -> None:
    """Note that `promise` ("S1") was proved at `figure` ("10^6 commands, 0 outside limits")."""
    target = os.environ.get(FIGURES_VARIABLE)
    if target:
        with Path(target).open("a") as file:
            file.write(json.dumps({"promise": promise, "figure": figure}) + "\n")


def volume(usual: int, long: int) -> int:
    """How much a test does: `usual` in CI, `long` under `hil verify --long`."""
    return long if os.environ.get(LONG_VARIABLE) else usual
