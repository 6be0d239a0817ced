"""The speed profile asks for what tyres give with the stated probability, and no less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.adoption.usable_grip import MIN_CAPACITY, capacity, lateral_shape
from planner.problem.infomax import sigma_points

AXLES = ((1, 2, 3), (4, 5, 6))
MEAN = np.array([50_000.0, 9.0, 1.35, 1.3567, 10.0, 1.4, 1.3392])
NOTHING = (0.0, 0.0)


def known_to(share: float) -> np.ndarray:
    return np.diag((share * MEAN) ** 2)


def test_a_certain_belief_leaves_the_share_that_is_used() -> None:
    front, rear = capacity(AXLES, MEAN, known_to(0.0), use=0.98, level=2.0, held=NOTHING)
    assert front == pytest.approx(0.98 * MEAN[3], rel=0.01)
    assert rear == pytest.approx(0.98 * MEAN[6], rel=0.01)


def test_the_force_asked_for_is_given_with_the_stated_probability() -> None:
    """Tyres drawn from the belief bear it within the share used, in all but the tail beyond two sigma."""
    covariance = known_to(0.06)
    asked = capacity(AXLES, MEAN, covariance, use=0.98, level=2.0, held=NOTHING)
    tyres = np.random.default_rng(4).multivariate_normal(MEAN, covariance, size=20_000)
    for axle, force in zip(AXLES, asked, strict=True):
        assert np.mean(force > 0.98 * tyres[:, axle[2]]) < 0.0228 + 0.004


def test_at_the_slip_asked_for_no_sigma_point_uses_more_of_its_peak() -> None:
    covariance = known_to(0.1)
    asked = capacity(AXLES, MEAN, covariance, use=0.9, level=2.0, held=NOTHING)
    for axle, force in zip(AXLES, asked, strict=True):
        points = sigma_points(MEAN, covariance, axle, 2.0)[list(axle)]
        slips = lateral_shape(MEAN[list(axle)][:, None])[:, 0] < force
        first = int(np.argmin(slips)) if not slips.all() else len(slips)
        assert (lateral_shape(points)[:first] / points[2]).max() <= 0.9 + 1e-9


def test_a_force_the_car_has_held_is_asked_for_again_as_far_as_the_mean_agrees() -> None:
    covariance = np.zeros((7, 7))
    covariance[3, 3] = (0.2 * MEAN[3]) ** 2
    doubtful, _ = capacity(AXLES, MEAN, covariance, use=0.98, level=2.0, held=NOTHING)
    shown, _ = capacity(AXLES, MEAN, covariance, use=0.98, level=2.0, held=(1.2, 0.0))
    too_much, _ = capacity(AXLES, MEAN, covariance, use=0.98, level=2.0, held=(1.9, 0.0))
    assert doubtful < shown == pytest.approx(1.2)
    assert too_much <= 0.98 * MEAN[3]


@given(st.floats(0.0, 0.4), st.floats(0.0, 0.4))
def test_more_doubt_never_widens_what_is_asked_for(one: float, other: float) -> None:
    less, more = sorted((one, other))
    tight, wide = (
        capacity(AXLES, MEAN, known_to(s), use=0.98, level=2.0, held=NOTHING) for s in (less, more)
    )  # fmt: skip
    assert all(w <= t + 1e-9 for w, t in zip(wide, tight, strict=True))
    assert min(wide) >= MIN_CAPACITY
