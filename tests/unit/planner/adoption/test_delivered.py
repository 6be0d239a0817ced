"""What the car fails to deliver is taken off plans at once, and comes back slowly."""

from __future__ import annotations

import numpy as np
import pytest

from hil_gateway.bus.delivered import Delivered
from planner.adoption.delivered import LEAST, USUAL, DeliveredShares, grip_factors
from planner.problem.load_limits import SLEW


def told(front: float | None = None, rear: float | None = None, brakes: float | None = None) -> Delivered:
    return Delivered(front=front, rear=rear, brakes=brakes)


def test_a_loss_counts_at_once_and_for_its_axle_only() -> None:
    now = DeliveredShares()
    assert now.take(told(front=0.75))
    assert now.tyres == (0.75, 1.0)


def test_model_errors_are_no_loss() -> None:
    now = DeliveredShares()
    assert not now.take(told(front=USUAL + 0.01, rear=1.1, brakes=0.85))
    assert (now.tyres, now.brakes) == ((1.0, 1.0), 1.0)


def test_what_is_no_longer_used_stays_as_it_was_seen_last() -> None:
    now = DeliveredShares()
    now.take(told(rear=0.7))
    assert not now.take(None)
    assert not now.take(told(front=1.0))
    assert now.tyres == (1.0, 0.7)


def test_grip_comes_back_as_fast_as_parameters_may_change() -> None:
    now = DeliveredShares()
    now.take(told(front=0.8))
    now.take(told(front=1.0))
    assert now.tyres[0] == pytest.approx(0.8 * (1.0 + SLEW))
    for _ in range(30):
        now.take(told(front=1.0))
    assert now.tyres[0] == 1.0


def test_a_wild_reading_leaves_grip_to_steer_with() -> None:
    now = DeliveredShares()
    now.take(told(front=-2.0, rear=0.0))
    assert now.tyres == (LEAST, LEAST)


def test_faded_brakes_are_pressed_harder_for_the_same_force() -> None:
    now = DeliveredShares()
    now.take(told(brakes=0.7))
    assert now.acting(now.sent(-0.2)) == pytest.approx(-0.2)
    assert now.sent(-0.2) == pytest.approx(-0.2 / 0.7)
    assert now.sent(0.1) == now.acting(0.1) == 0.1


def test_an_axle_whose_wheels_lock_brakes_less_with_every_plan_until_they_roll() -> None:
    now, locks = DeliveredShares(), Delivered(front=None, rear=None, brakes=None, locking=(True, False))
    shares = [1.0]
    for _ in range(25):
        assert now.take(locks) or shares[-1] == now.rolling[0]
        shares.append(now.rolling[0])
        assert now.rolling[1] == 1.0, "the other axle's wheels roll"
    assert np.all(np.diff(shares[:4]) < 0.0), "with every plan"
    assert shares[5] < 0.6, "wheels roll again with half of what locked them, within a quarter of a second"
    assert shares[-1] > 0.4, "a car without brakes stops nowhere"
    regained = 0
    while now.rolling[0] < 1.0:
        now.take(told())
        regained += 1
    assert 1.0 < regained / 20.0 < 5.0, "s: slowly, or the wheels lock again"


def test_grip_is_taken_off_the_peaks_alone() -> None:
    per_axle = ((1, 2, 3), (4, 5, 6))
    assert grip_factors(per_axle, (0.8, 0.9), 7).tolist() == [1, 1, 1, 0.8, 1, 1, 0.9]
    assert np.array_equal(grip_factors(((1, 2, 3),) * 2, (0.8, 0.9), 4), [1, 1, 1, 0.8])
