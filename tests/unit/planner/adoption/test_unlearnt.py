"""A car that does not learn is steered for the most oversteer its data sheet allows, and keeps its first reserves."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.belief.revision import race_car_revision, tyre_covariance
from estimator.model.parameters import tyre_prior
from hil_gateway.car.car import load_car
from hil_gateway.config import load_config
from hil_gateway.track.loading import load_track
from planner.adoption.adoption import Adoption
from planner.adoption.unlearnt import oversteering
from planner.problem.load_limits import LoadLimits
from planner.problem.settings import settings_of

AXLES = ((1, 2, 3), (4, 5, 6))
THETA = np.array([*tyre_prior(load_car(), "per_axle").values()])
STATED = tyre_covariance(race_car_revision(load_car(), "per_axle"))
SPREAD = np.hypot(0.2, 0.2)
"""of B front over B rear by the data sheet"""


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


def test_every_lap_keeps_back_what_the_first_does() -> None:
    config = load_config(None, {"track": "oval", "estimator.learn": False})
    start = race_car_revision(load_car(), "per_axle")
    adoption = Adoption(config, load_track(config.track), settings_of(config), LoadLimits(0.0, 0.0), start)
    first = adoption.controller.knowledge
    adoption.begin_lap(1)
    adoption.advance()
    later = adoption.controller.knowledge
    assert (later.level, later.capacity) == (first.level, first.capacity)
