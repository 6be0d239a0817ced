"""The declared race car: what it has beyond Eq. (1)-(3), and a belief about its effects beside its tyres."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.belief.revision import (
    SESSION_SPREAD,
    RevisionPolicy,
    carried_over,
    declared_revision,
    learns_effects,
    model_of,
    race_car_revision,
    starting_revision,
    tyre_covariance,
)
from estimator.belief.tyre_belief import BeliefSettings, Sample, TyreBelief
from estimator.model.measurement import measurement_function
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY, DRIVE_BEFORE
from hil_gateway.car.car import load_car
from hil_gateway.config import EstimatorConfig, load_config

VEHICLE = load_car().vehicle
START = race_car_revision(load_car(), "per_axle")
REVISED = model_of(START, VEHICLE, 1000.0)
EXTRA = AUXILIARY.index("extra_load")
ORDER = (*START.tyre, *(f"{e.name}.{p}" for e in START.effects for p in e.parameters))
BEFORE = [AUXILIARY.index(name) for name in DRIVE_BEFORE]


def belief() -> TyreBelief:
    made = TyreBelief(REVISED.model, BeliefSettings(correlation_samples=1.0), REVISED.constants)
    made.set_covariance(np.array(START.covariance))
    return made


def driven(belief: TyreBelief, truth: np.ndarray, count: int, seed: int) -> None:
    """Corners, drives and brakes at 15 to 75 m/s of a car with parameters `truth`, measured with noise."""
    h = measurement_function(REVISED.model, "imu_yaw", with_effects=True)
    draw, std = np.random.default_rng(seed), belief.settings.channel_std(load_car().vehicle.mass)
    unseen = np.zeros(len(REVISED.constants))
    for _ in range(count):
        vx, slip = draw.uniform(15.0, 75.0), draw.uniform(-0.07, 0.07)
        signals = np.array([vx, -vx * slip, 0.0, draw.uniform(-0.04, 0.04), draw.uniform(-0.2, 0.12)])
        aux = np.zeros(len(AUXILIARY))
        aux[EXTRA] = draw.uniform(-0.2, 0.4)
        aux[BEFORE] = draw.uniform(-0.1, 0.1, len(BEFORE)).cumsum()
        z = np.array(h(signals, aux, truth, unseen)[0]).ravel() + std * draw.normal(size=3)
        belief.update(Sample(signals, np.zeros((3, 3)), z, aux, unseen))


def test_effects_of_another_car_are_learnt_beside_its_tyres() -> None:
    made, draw = belief(), np.random.default_rng(1)
    spread = np.sqrt(np.diag(np.array(START.covariance)))
    truth = made.prior + spread * draw.choice([-1.0, 1.0], size=len(spread))
    delay = ORDER.index("drive_delay.delay")
    truth[delay] = abs(truth[delay])
    driven(made, truth, 3000, seed=2)
    before, after = (np.abs(truth - mean) / spread for mean in (made.prior, made.mean))
    assert np.median(after) < 0.3 * np.median(before)
    names = dict(zip(ORDER, after, strict=True))
    assert names["aero_drag.k"] < 0.3
    assert names["steer_offset.offset"] < 0.3
    assert names["drive_delay.delay"] < 0.3
    assert names["front_brake.gain"] < 0.3


def test_a_revision_carries_what_was_learnt_of_effects_by_small_steps() -> None:
    made, drag = belief(), ORDER.index("aero_drag.k")
    truth = made.prior.copy()
    truth[drag] *= 1.2
    driven(made, truth, 2000, seed=3)
    policy = RevisionPolicy(EstimatorConfig(revision_min_samples=100, revision_max_step=0.05), START)
    revisions = [START, *(policy.message(made, i, i) for i in range(8))]
    drags = np.array([e.parameters["k"] for r in revisions for e in r.effects if e.name == "aero_drag"])
    assert np.all(np.diff(drags) / drags[1] < 0.06)
    assert drags[-1] == pytest.approx(float(made.mean[drag]), rel=0.03)


def test_the_planner_hears_of_a_rear_axle_a_third_softer_within_three_seconds() -> None:
    made = belief()
    made.samples, row = 200, made.names.index("br")
    made.deviation[row] = -made.prior[row] / 3.0 / made.scale[row]
    policy = RevisionPolicy(EstimatorConfig(), START)
    told = [policy.message(made, i, i).tyre["br"] for i in range(3)]  # one a second
    assert told[-1] == pytest.approx(made.prior[row] * 2.0 / 3.0, rel=0.01)


def test_a_belief_without_effects_leaves_a_revisions_effects_alone() -> None:
    fixed = START.model_copy(update={"covariance": ()})
    assert not learns_effects(fixed)
    policy = RevisionPolicy(EstimatorConfig(revision_min_samples=1), fixed)
    made = TyreBelief(REVISED.model)
    made.samples, made.deviation = 1000, 0.2 * np.ones(7)
    assert policy.message(made, 0, 1).effects == START.effects


def test_the_planner_hears_of_the_tyres_only() -> None:
    covariance = tyre_covariance(START)
    assert covariance is not None
    assert covariance.shape == (7, 7)
    assert learns_effects(START)


def test_a_dip_loads_both_axles_and_a_crest_unloads_them() -> None:
    h = measurement_function(REVISED.model, "tyre_force")
    signals, aux = np.array([50.0, -2.0, 0.0, 0.0, 0.0]), np.zeros(len(AUXILIARY))
    forces = []
    for extra in (-0.3, 0.0, 0.5):
        aux[EXTRA] = extra
        forces.append(np.array(h(signals, aux, REVISED.theta, REVISED.constants)[0]).ravel()[1:])
    assert np.all(forces[0] < forces[1])
    assert np.all(forces[1] < forces[2])


def test_the_model_to_start_with_is_what_is_configured() -> None:
    assert starting_revision(load_config(), "").effects == START.effects
    paper = load_config(None, {"declared_model": "paper"})
    assert starting_revision(paper, "") == declared_revision(tyre_prior(load_car(), "per_axle"))


def test_what_an_earlier_session_learnt_is_never_surer_than_sessions_differ() -> None:
    certain = START.model_copy(update={"covariance": tuple(map(tuple, (1e-8 * np.array(START.covariance)).tolist()))})
    std = np.sqrt(np.diag(carried_over(certain).covariance))
    values = np.array([*certain.tyre.values(), *(v for e in certain.effects for v in e.parameters.values())])
    assert std[values != 0.0] == pytest.approx(SESSION_SPREAD * values[values != 0.0], rel=1e-3)
    assert np.all(std > 3e-4), "a rack that is put together again is 0.02 deg off at least"
    assert np.all(np.diag(carried_over(START).covariance) > np.diag(START.covariance))
    assert carried_over(declared_revision(tyre_prior(load_car(), "per_axle"))) == declared_revision(
        tyre_prior(load_car(), "per_axle")
    ), "nothing learnt, nothing added"
