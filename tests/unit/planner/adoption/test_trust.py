"""Where the car slides less is asked for at once, at that place only, and it comes back lap by lap."""

from __future__ import annotations

import numpy as np
import pytest

from planner.adoption.trust import AFTER_M, BACK, BEFORE_M, CONFIRMED, LOSS, Trust

LENGTH = 1000.0


def slid_at(s: float) -> Trust:
    trust = Trust(500, LENGTH)
    for _ in range(CONFIRMED):
        trust.watch(True, s)
    return trust


def test_a_slide_takes_speed_away_around_its_place_only() -> None:
    trust = slid_at(400.0)
    places = np.arange(500) * LENGTH / 500
    near = (places >= 400.0 - BEFORE_M) & (places < 400.0 + AFTER_M)
    assert np.all(trust.share[near] == pytest.approx(1.0 - LOSS))
    assert np.all(trust.share[~near] == 1.0)


def test_a_slide_at_the_line_reaches_back_into_the_lap_before() -> None:
    trust = slid_at(10.0)
    assert trust.share[-1] < 1.0
    assert trust.share[250] == 1.0


def test_one_plan_beyond_the_peak_is_no_slide() -> None:
    trust = Trust(500, LENGTH)
    for s in range(0, 900, 20):
        assert not trust.watch(s % 40 == 0, float(s))
    assert trust.slides == 0


def test_trust_comes_back_lap_by_lap_and_never_beyond_one() -> None:
    trust = slid_at(400.0)
    assert trust.watch(False, LENGTH + 1.0)
    assert trust.share.min() == pytest.approx(1.0 - LOSS + BACK)
    for lap in range(2, 12):
        trust.watch(False, lap * LENGTH + 1.0)
    assert np.all(trust.share == 1.0)


def test_many_slides_leave_the_grip_of_a_wet_road() -> None:
    """Slicks on wet asphalt keep 0.5 to 0.6 of their friction; with less the car would stand in its own way."""
    trust = Trust(500, LENGTH)
    for i in range(200):
        trust.watch(True, 60.0 * i % LENGTH)
    assert 0.45 < trust.share.min() < 0.65
    assert trust.slides > 50
