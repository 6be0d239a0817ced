"""Unknown brakes and unknown tyres: the load that both lead to, with the stated probability."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from estimator.belief.revision import declared_revision, race_car_revision
from estimator.model.parameters import tyre_prior
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.car.car import load_car
from hil_gateway.config import load_config
from hil_gateway.track.loading import load_track
from planner.adoption import adoption as adoption_of
from planner.adoption.adoption import Adoption
from planner.adoption.brake_doubt import brake_doubt, brake_spread
from planner.line.envelope import Brakes, envelope_of
from planner.problem.load_limits import LoadLimits
from planner.problem.settings import settings_of
from planner.solver.functions import build_functions

START = race_car_revision(load_car(), "per_axle")


def known(share: float) -> ModelRevision:
    """The declared car with standard deviations times `share`."""
    covariance = (share**2 * np.array(START.covariance)).tolist()
    return START.model_copy(update={"covariance": tuple(map(tuple, covariance)), "revision": f"{share}"})


@pytest.mark.parametrize(("force", "grip"), [(0.13, 0.11), (0.05, 0.12), (0.12, 0.03), (0.2, 0.0)])
def test_a_load_within_the_factor_is_exceeded_as_often_as_stated(force: float, grip: float) -> None:
    draw = np.random.default_rng(3)
    share = (1.0 + force * draw.normal(size=400_000)) / (1.0 + grip * draw.normal(size=400_000))
    front, rear = brake_doubt((force, force), np.array([grip, grip]), 2.0)
    assert front == rear
    assert float(np.mean(share > front / (1.0 - 2.0 * grip))) == pytest.approx(0.0228, abs=0.001)


def test_brakes_that_are_known_count_once() -> None:
    assert brake_doubt((0.0, 0.0), np.array([0.1, 0.3]), 2.0) == pytest.approx((1.0, 1.0))


def test_the_force_of_the_brakes_is_in_doubt_as_declared_and_the_engine_says_nothing_of_it() -> None:
    front, rear = brake_spread(START)
    assert front == pytest.approx(np.hypot(0.10, 0.08), abs=1e-3)
    assert rear == pytest.approx(front)
    names = [*START.tyre, *(f"{e.name}.{key}" for e in START.effects for key in e.parameters)]
    engine, gain = names.index("cx"), names.index("front_brake.gain")
    covariance = np.array(START.covariance)
    weak = -0.1
    moved = covariance[gain, engine] / covariance[engine, engine] * weak * START.tyre["cx"]
    assert (1.0 + weak) * (1.0 + moved) == pytest.approx(1.0, abs=0.011), "a weak engine leaves the brakes as they are"


def test_a_model_that_learns_no_brakes_has_no_doubt_of_them() -> None:
    assert brake_spread(declared_revision(tyre_prior(load_car(), "per_axle"))) == (0.0, 0.0)


def test_a_first_lap_keeps_more_standard_deviations_and_later_laps_those_stated() -> None:
    config = load_config(None, {"track": "oval"})
    adoption = Adoption(config, load_track(config.track), settings_of(config), LoadLimits(0.0, 0.0), START)
    first = adoption.controller.knowledge
    adoption.begin_lap(1)
    for _ in range(3):
        adoption.advance()
    later = adoption.controller.knowledge
    assert (first.level, later.level) == (2.5, config.planner.sigma_level)
    assert all(now > then for now, then in zip(later.capacity, first.capacity, strict=True))
    assert all(now < then for now, then in zip(later.brake_doubt, first.brake_doubt, strict=True))


def test_without_a_data_sheet_the_stated_deviations_hold_in_a_first_lap_and_either_axle_may_use_as_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(adoption_of, "build_functions", partial(build_functions, compiled=False))  # none is called
    config = load_config(None, {"track": "oval", "declared_model": "paper"})
    start = declared_revision(tyre_prior(load_car(), "per_axle"))
    weak_rear = start.model_copy(update={"tyre": {**start.tyre, "dr": 0.7 * start.tyre["dr"]}})
    adoption = Adoption(config, load_track(config.track), settings_of(config), LoadLimits(0.0, 0.0), weak_rear)
    assert adoption.controller.knowledge.level == config.planner.sigma_level
    assert adoption.controller.knowledge.load_asked == (config.planner.load_use, config.planner.load_use)


def test_plans_and_profile_brake_harder_once_the_brakes_are_known() -> None:
    config = load_config(None, {"track": "oval"})
    found = []
    for share in (1.0, 0.2):
        adoption = Adoption(config, load_track(config.track), settings_of(config), LoadLimits(9.0, 9.0), known(share))
        knowledge, problem = adoption.controller.knowledge, adoption.controller.problem
        assert tuple(adoption.controller.common[problem.common["brake_doubt"]]) == knowledge.brake_doubt
        brakes = Brakes(settings_of(config).brakes, knowledge.brake_ratio, knowledge.brake_doubt)
        revised = adoption.current.revised
        found.append(
            envelope_of(
                revised.model, list(revised.theta), list(revised.constants), brakes=brakes, car=load_car()
            ).brake[0]
        )
    assert found[0] < 0.95 * found[1]
