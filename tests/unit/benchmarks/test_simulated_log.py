"""Simulated drives as drive logs: whole laps, one seed one log, the effect named in the notes."""

from __future__ import annotations

import numpy as np

from benchmarks.driving.simulated_log import simulate


def test_log_has_the_laps_asked_for_in_one_piece() -> None:
    log = simulate({"aero_drag": 0.6}, laps=2, seed=3, track="oval")
    assert [number for number, _ in log.laps()][:2] == [0, 1]
    assert len(log.segments()) == 1
    assert abs(log.step - 0.01) < 1e-9
    times = [float(np.ptp(log["t"][rows])) for _, rows in log.laps()]
    assert times[1] < times[0]  # each lap is driven faster than the one before
    assert log.notes == ("simulated: paper, aero_drag=0.6, seed 3",)
