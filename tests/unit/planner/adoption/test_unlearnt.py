"""A car that does not learn is steered for the most oversteer its data sheet allows, and trusts measured loads."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.belief.revision import race_car_revision, tyre_covariance
from estimator.model.parameters import tyre_prior
from hil_gateway.bus.delivered import Delivered
from hil_gateway.bus.messages import Estimate
from hil_gateway.car.car import load_car
from planner.adoption.unlearnt import measured_loads, oversteering

AXLES = ((1, 2, 3), (4, 5, 6))
THETA = np.array([*tyre_prior(load_car(), "per_axle").values()])
CAR = load_car().vehicle
STATED = tyre_covariance(race_car_revision(load_car(), "per_axle"))
SPREAD = np.hypot(0.2, 0.2)
"""of B front over B rear by the data sheet"""


def moving(delivered: Delivered | None) -> Estimate:
    """Front slip 0.05 rad, rear slip 0.02 rad."""
    return Estimate(
        stamp_ns=0, seq=0, state_stamp_ns=0, valid=True, x=0.0, y=0.0, yaw=0.0, vx=50.0, vy=-50.0 * np.tan(0.02),
        yaw_rate=0.0, bias_ax=0.0, bias_ay=0.0, bias_yaw_rate=0.0, std=(0.0,) * 9, steer=0.03, drive=0.0,
        innovations_rejected=0, delivered=delivered,
    )  # fmt: skip


def test_front_tyres_count_as_stiffer_by_the_spread_of_the_balance_until_they_answer() -> None:
    assert STATED is not None
    made = oversteering(THETA, STATED, AXLES, np.inf)
    assert made[1] == pytest.approx((1.0 + SPREAD) * THETA[1])
    assert np.delete(made, 1).tolist() == np.delete(THETA, 1).tolist()


def test_front_tyres_count_as_they_answer_within_the_spread() -> None:
    assert STATED is not None
    assert oversteering(THETA, STATED, AXLES, 1.1)[1] == pytest.approx(1.1 * THETA[1])
    assert oversteering(THETA, STATED, AXLES, 0.2)[1] == pytest.approx((1.0 - SPREAD) * THETA[1])


def test_a_well_known_model_is_driven_as_it_is() -> None:
    known = np.diag((0.03 * THETA) ** 2)
    assert oversteering(THETA, known, AXLES, np.inf)[1] < 1.05 * THETA[1]


def test_tyres_shared_by_both_axles_have_no_balance() -> None:
    shared = THETA[:4]
    assert oversteering(shared, np.diag((0.2 * shared) ** 2), ((1, 2, 3),) * 2, np.inf).tolist() == shared.tolist()


def test_a_load_counts_as_it_was_delivered() -> None:
    full = measured_loads(moving(Delivered(front=1.0, rear=1.0, brakes=None)), THETA, CAR, AXLES)
    front, rear = measured_loads(moving(Delivered(front=0.8, rear=0.9, brakes=None)), THETA, CAR, AXLES)
    assert full[0] > full[1] > 0.0
    assert (front, rear) == (pytest.approx(0.8 * full[0]), pytest.approx(0.9 * full[1]))


def test_what_nothing_tells_is_not_held() -> None:
    assert measured_loads(moving(None), THETA, CAR, AXLES) == (0.0, 0.0)
    assert measured_loads(moving(Delivered(front=None, rear=1.0, brakes=None)), THETA, CAR, AXLES)[0] == 0.0
