"""Processes that run at their own times, and that other programs hold up now and then, stop no car."""

from __future__ import annotations

import pytest

from benchmarks.faults.held_up import HeldUpLoop
from hil_gateway.config import load_config


@pytest.mark.slow
@pytest.mark.parametrize(("track", "seed"), [("oval", 4), pytest.param("road_course", 5, marks=pytest.mark.long)])
def test_pauses_of_45_ms_stop_no_car(track: str, seed: int) -> None:
    result = HeldUpLoop(load_config(None, {"track": track}), seed).run(seconds=40.0)
    assert result.failsafes == []
    assert result.off_track == 0
    assert result.worst_margin_m > 0.0
    assert result.peak_speed > 40.0
