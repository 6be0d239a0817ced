"""A first start: an empty cache, so that every function is compiled while the car stands and waits."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest
from support.live_loop import STOPS, LiveLoop

from hil_gateway.process.processor_wait import TIMING_CAUSES

STANDS_S, DISTANCE_M, WITHIN_S = 60.0, 100.0, 60.0


@pytest.mark.slow
def test_a_car_that_stood_for_a_minute_drives_100_m_from_an_empty_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the positions that the car reports."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with LiveLoop(tmp_path / "drive") as loop:
        loop.look(STANDS_S)
        start = place(loop)
        loop.drive_off()
        deadline = time.monotonic() + WITHIN_S
        while math.dist(start, place(loop)) < DISTANCE_M:
            assert time.monotonic() < deadline, f"{loop.action} {loop.cause}, {math.dist(start, place(loop)):.0f} m"
            loop.look(0.2)
            if loop.action in STOPS and loop.cause in TIMING_CAUSES:  # the machine was late, not the start
                loop.drive_off()
        assert not loop.judge.faults
        assert not loop.died()


def place(loop: LiveLoop) -> tuple[float, float]:
    """Where the car says it is, m in the map."""
    state = loop.state.latest.message
    assert state is not None
    return state.position_x, state.position_y
