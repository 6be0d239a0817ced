"""Two laps side by side as one self-contained HTML page: nothing is loaded from anywhere."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from hil_gateway.dashboard.look import look
from hil_gateway.dashboard.server import FOLDER as PAGE
from hil_gateway.dashboard.setup import track_outline
from hil_gateway.process.shipped import shipped
from hil_gateway.session.overview.lap_table import LapTable, title
from hil_gateway.track.track import Track

FOLDER = shipped("hil_gateway", "dashboard/compare")


def page(first: LapTable, second: LapTable, track: Track) -> str:
    """HTML of the comparison; positive delta where the second lap is behind."""
    parts = {
        "@STYLE@": (PAGE / "uplot/uPlot.min.css").read_text() + look() + (PAGE / "style.css").read_text(),
        "@UPLOT@": (PAGE / "uplot/uPlot.iife.min.js").read_text(),
        "@SCRIPT@": (FOLDER / "compare.js").read_text(),
        "@DATA@": json.dumps(comparison(first, second, track), allow_nan=False).replace("<", "\\u003c"),
    }
    html = (FOLDER / "compare.html").read_text()
    for mark, text in parts.items():
        html = html.replace(mark, text)
    return html


def comparison(first: LapTable, second: LapTable, track: Track) -> dict[str, Any]:
    """Everything the page draws, over the same stations."""
    return {
        "titles": [title(first), title(second)],
        "sectors_s": [list(first.lap.sectors_s), list(second.lap.sectors_s)],
        "times_s": [first.lap.time_s, second.lap.time_s],
        "s": _list(first.s),
        "delta": _list(second.t - first.t, 3),
        "channels": {name: [_list(lap.channels[name]) for lap in (first, second)] for name in first.channels},
        "line": [{"x": _list(lap.x), "y": _list(lap.y)} for lap in (first, second)],
        "track": track_outline(track),
    }


def _list(values: Any, digits: int = 2) -> list[float]:
    rounded: list[float] = np.round(values, digits).tolist()
    return rounded
