"""The speed profile asks for what Eq. (10) leaves with the stated probability, and no less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.model.tyre import normalised_force
from planner.adoption.usable_grip import (
    LEAST_REAR,
    MIN_CAPACITY,
    MOST_SLIP,
    PROFILE_SHARE,
    capacity,
    rear_share,
    sustained_next,
)
from planner.problem.infomax import sigma_points

AXLES = ((1, 2, 3), (4, 5, 6))
PEAKS = [3, 6]
THETA = np.array([50_000.0, 9.0, 1.35, 1.3567, 10.0, 1.4, 1.3392])
USE = 0.95
NOTHING = (0.0, 0.0)

share = st.floats(0.0, 0.3)
load = st.floats(0.0, 2.0)


def asked(covariance: np.ndarray, level: float = 1.0, held: tuple[float, float] = NOTHING) -> np.ndarray:
    return np.array(capacity(AXLES, THETA, covariance, use=np.full(2, USE), level=level, sustained=held))


def test_a_certain_belief_leaves_the_whole_share_of_the_peak() -> None:
    assert asked(np.zeros((7, 7)), level=2.0) == pytest.approx(USE * THETA[PEAKS], rel=0.01)


@given(std=share, level=st.floats(0.0, 3.0), held=st.tuples(load, load))
def test_what_is_asked_never_exceeds_what_the_least_tyre_bears_unless_held(
    std: float, level: float, held: tuple[float, float]
) -> None:
    found = asked(np.diag((std * THETA) ** 2), level, held)
    peaks = THETA[PEAKS]
    sure = np.maximum(USE * peaks * (1.0 - level * std), MIN_CAPACITY)
    assert np.all(found <= np.maximum(sure, np.minimum(held, USE * peaks)) + 1e-9)


@given(level=st.floats(0.0, 3.0), held=st.tuples(load, load))
def test_more_doubt_never_asks_for_more(level: float, held: tuple[float, float]) -> None:
    found = np.array([asked(np.diag((std * THETA) ** 2), level, held) for std in np.linspace(0.0, 0.4, 9)])
    assert np.all(np.diff(found, axis=0) <= 1e-9)
    assert np.all(found >= MIN_CAPACITY), "the car has to move"


def test_a_held_load_is_asked_for_again_while_the_mean_agrees() -> None:
    doubt = np.zeros((7, 7))
    doubt[PEAKS, PEAKS] = (0.15 * THETA[PEAKS]) ** 2
    unseen = asked(doubt, 2.0)
    assert unseen == pytest.approx(USE * 0.7 * THETA[PEAKS])
    front, rear = asked(doubt, 2.0, (1.1, 3.0))
    assert front == pytest.approx(1.1)
    assert rear == pytest.approx(USE * THETA[6], rel=0.01), "no further than the mean agrees"
    assert asked(doubt, 2.0, (0.5, 0.5)) == pytest.approx(unseen), "less than is sure changes nothing"


def test_a_rear_axle_that_gives_way_first_keeps_away_from_its_peak_and_no_other_does() -> None:
    assert [rear_share(np.array(peaks)) for peaks in ((1.3, 1.4), (1.4, 1.4))] == [1.0, 1.0]
    weaker = [rear_share(np.array([1.4, rear])) for rear in np.linspace(1.34, 1.0, 30)]
    assert np.all(np.diff(weaker) <= 0.0)
    assert (weaker[0] > 0.99, weaker[-1]) == (True, LEAST_REAR), "and the car still corners"


def test_front_tyres_that_bore_a_force_for_laps_are_asked_for_a_little_more_and_rear_ones_are_not() -> None:
    """By the speed profile, which asks for a share of what it is given."""
    front, rear = sustained_next((1.0, 1.0), (1.0, 1.0))
    assert 1.0 < PROFILE_SHARE * front < 1.03
    assert rear == 1.0
    assert sustained_next((1.1, 1.0), (0.5, 1.0))[0] == 1.1, "what was held in this lap is asked for again, no more"


def test_each_axle_is_asked_for_what_its_own_tyres_bear() -> None:
    front_in_doubt = np.zeros((7, 7))
    front_in_doubt[3, 3] = (0.1 * THETA[3]) ** 2
    front, rear = asked(front_in_doubt, 2.0)
    assert front == pytest.approx(USE * 0.8 * THETA[3])
    assert rear == pytest.approx(USE * THETA[6], rel=0.01)


def test_parameters_known_only_together_cost_little_where_the_force_is_known() -> None:
    """C and D are in doubt by a third, but force up to 0.09 rad has been measured to 4 %, and held."""
    slips = np.linspace(0.0, 0.09, 50)
    shapes = []
    for i in range(3):
        up, down = (THETA[1:4].copy() for _ in range(2))
        up[i] *= 1.001
        down[i] *= 0.999
        difference = [t[2] * np.sin(t[1] * np.arctan(t[0] * slips)) for t in (up, down)]
        shapes.append((difference[0] - difference[1]) / (0.002 * THETA[1 + i]))
    H = np.array(shapes).T / 0.04
    covariance = np.zeros((7, 7))
    covariance[1:4, 1:4] = np.linalg.inv(H.T @ H + np.diag(1.0 / (0.4 * THETA[1:4]) ** 2))
    marginal = np.sqrt(covariance[3, 3]) / THETA[3]
    assert marginal > 0.1
    known, unknown = (asked(c, 1.0, (2.0, 2.0))[0] for c in (covariance, np.diag(np.diag(covariance))))
    assert known > 1.03 * unknown


def test_within_the_profile_no_choice_of_theta_uses_more_than_its_share() -> None:
    """However much was held: the load rows hold there, so a profile beyond them would not be followed."""
    covariance = np.diag((0.15 * THETA) ** 2)
    for axle, found in zip(AXLES, asked(covariance, 1.0, (2.0, 2.0)), strict=True):
        points = sigma_points(THETA, covariance, axle, 1.0)[list(axle)]
        slips = np.linspace(0.0, MOST_SLIP, 1001)[:, None]
        shares = normalised_force(slips, *points) / points[2]
        force = normalised_force(slips[:, 0], *THETA[list(axle)])
        within = force[: int(np.argmax(force))] <= found + 1e-9
        assert shares[: int(within.sum())].max() <= USE + 1e-9
        assert found > 0.5 * THETA[axle[2]]
