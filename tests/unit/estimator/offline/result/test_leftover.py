"""What is said of scored laps that drive beyond the laps learnt from."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimator.offline.result.leftover import _beyond_reach

T = np.arange(0.0, 200.0, 0.1)
SCORED = T > 100.0


@pytest.mark.parametrize(
    ("fast", "left", "said"),
    [
        ([120.0, 160.0], [120.0, 160.0], "vx"),
        ([120.0], [120.0], None),
        ([120.0, 160.0], [120.0, 180.0], None),
        ([], [120.0, 160.0], None),
    ],
    ids=["a law of speed", "came once", "also elsewhere", "speeds known"],
)
def test_what_is_left_beyond_every_speed_learnt_from_is_said_of_speed_where_that_came_twice(
    fast: list[float], left: list[float], said: str | None
) -> None:
    """`fast` and `left` are seconds at which five of speed, and of residual, begin."""
    speed = 30.0 + 5.0 * np.sin(T) + 10.0 * _during(fast)
    signals = {"t": T, "vx": speed, "ay": _during(left), "track_position": (7.0 * T) % 500.0}
    record: Any = SimpleNamespace(signals=signals, bases=dict.fromkeys(signals), extra=())
    found = _beyond_reach(record, np.arange(len(T)), SCORED, _during(left) + 0.01)
    assert (found and found[0]) == said
    if found is not None:
        assert found[1][0][0] > 34.9


def _during(starts: list[float]) -> np.ndarray:
    inside = [(start <= T) & (start + 5.0 > T) for start in starts]
    return np.asarray(np.any([np.zeros(len(T), bool), *inside], axis=0), float)
