"""A track with a straight banked by 20 degrees and one that climbs and falls by 12 % and by 20 %."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

LAYOUT = """
name = "slopes"
width = 20.0
[[segment]]
straight = 700.0
bank_deg = 20.0
[[segment]]
corner = 180.0
radius = 80.0
transition = 60.0
bank_deg = 20.0
[[segment]]
straight = 700.0
[[segment]]
corner = 180.0
radius = 80.0
transition = 60.0
bank_deg = 20.0
"""
RAMPS = ((100, 0.12), (100, 0.2), (60, 0.0), (100, -0.2), (100, -0.12))
"""length, m, and rise over it, one after the other from arc length 1050 on"""


@cache
def sloped_file() -> Path:
    """The track's file."""
    rises = [0.0, *(rise for length, rise in RAMPS for _ in range(length // 20))]
    places = [(0.0, 0.0), *((1050.0 + 20 * i, 20 * sum(rises[: i + 1])) for i in range(len(rises)))]
    heights = "".join(f"[[elevation]]\ns = {s}\nz = {z:.3f}\n" for s, z in places)
    path = Path(tempfile.mkdtemp(prefix="hil-slopes-")) / "slopes.toml"
    path.write_text(LAYOUT + heights)
    return path


@cache
def sloped_track() -> Track:
    """The track itself."""
    return load_track(sloped_file())


def place_of(grade: float = 0.0, bank_deg: float = 0.0) -> float:
    """Arc length in the middle of the longest stretch with this grade (rise over length) and bank, m."""
    track = sloped_track()
    fits = (np.abs(np.tan(track.grade) - grade) < 0.01) & (np.abs(np.degrees(np.abs(track.bank)) - bank_deg) < 0.5)
    edges = np.flatnonzero(np.diff(np.r_[0, fits.astype(int), 0]))
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return float(track.s[(starts[longest] + ends[longest]) // 2])
