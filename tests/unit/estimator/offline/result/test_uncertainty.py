"""What a diagnosis states of its own errors: scatter, declared data, sampling."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student
from support.drives.practice_drives import PRIOR, record_of

from estimator.offline.diagnosis import held_out_in_turn
from estimator.offline.fit.fixed_parameters import MASS_ERROR, ZERO_ERROR, by_declared, by_sampling, by_zero
from estimator.offline.fit.normal import Normal
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.record.unknown_inputs import sampling_effects
from estimator.offline.result.uncertainty import FALSE_ALARM, covariance, critical_errors, insignificant, taken_back
from estimator.offline.search.empirical import Term
from estimator.offline.search.evidence import compare
from estimator.offline.search.trial import Setting, fit_names
from hil_gateway.car.vehicle import GRAVITY


@pytest.fixture
def pair(drives: dict[str, Any]) -> Fit:
    record = record_of(drives["pair"])
    stretched = replace(record, lap=held_out_in_turn(record.windows))
    return fit_names(Setting(stretched, "per_axle", PRIOR), ("aero_drag", "steer_offset"), None)


def test_the_scatter_of_a_mean_over_few_stretches_is_that_of_student() -> None:
    means = np.array([1.0, 1.4, 0.7, 1.1, 0.8])
    stretches, each = len(means), 20.0
    at = means - means.mean()  # gradient of the squares at the mean of all
    gradient, hessian = np.zeros((5, stretches, 1)), np.zeros((5, stretches, 1, 1))
    gradient[0, :, 0], hessian[0, :, 0, 0] = each * at, each
    squares, none = np.ones((5, stretches)), np.zeros((1, 1))
    normal = Normal(squares, gradient, hessian, np.full(stretches, each), none, np.zeros(1), np.ones(5))
    half_width = student.ppf(0.975, stretches - 1) * means.std(ddof=1) / np.sqrt(stretches)
    assert 1.96 * np.sqrt(normal.jackknife_variance[0]) == pytest.approx(half_width, rel=1e-3)


def test_a_mass_that_is_off_moves_the_drag_in_proportion(pair: Fit) -> None:
    (drag,) = (b.parameters for b in pair.predictor.blocks if b.effect.name == "aero_drag")
    assert np.abs(by_declared(pair)[0, drag]) == pytest.approx(MASS_ERROR * pair.parameters[drag], rel=0.05)


def test_what_is_held_widens_what_is_stated(pair: Fit) -> None:
    stated, white = np.diag(covariance(pair)), np.diag(pair.covariance)
    held = np.sum(np.concatenate([by_sampling(pair), by_declared(pair)]) ** 2, axis=0)
    assert np.all(stated >= white + 0.999 * held)


def test_a_size_is_as_unsure_as_it_moves_without_an_empirical_term(pair: Fit) -> None:
    (drag,) = (b.parameters for b in pair.predictor.blocks if b.effect.name == "aero_drag")
    there = pair.parameters.copy()
    there[drag] += 0.3
    without = Fit(pair.predictor, there, pair.normal, pair.noise)
    added = np.diag(covariance(pair, without)) - np.diag(covariance(pair))
    assert added[drag] == pytest.approx(0.09)
    assert np.allclose(np.delete(added, drag), 0.0)


@pytest.mark.parametrize(("laps", "scatters"), [(4, True), (3, False)])
def test_a_size_that_differs_from_lap_to_lap_is_as_unsure_as_that(
    drives: dict[str, Any], laps: int, scatters: bool
) -> None:
    record = record_of(drives["none"])
    number = np.minimum(np.arange(len(record.lap_of_row)) * laps // len(record.lap_of_row), laps - 1)
    pushed = record.measured + np.outer([1.0, 0.0, 0.0, 0.0, 0.0], 0.4 * (-1.0) ** number)
    record = replace(record, measured=pushed, lap_of_row=number)
    record = replace(record, lap=held_out_in_turn(record.windows))
    done = fit_names(Setting(record, "per_axle", PRIOR), ("rolling_resistance",), None)
    (force,) = (b.parameters for b in done.predictor.blocks if b.effect.name == "rolling_resistance")
    error = np.sqrt(covariance(done)[force, force][0, 0])
    stretches = np.sqrt(done.normal.jackknife_variance[force][0])
    assert (error > 1.5 * stretches) == scatters


def test_the_zero_of_the_accelerometer_moves_a_bank_of_the_whole_lap_unless_it_is_fitted(
    drives: dict[str, Any], pair: Fit
) -> None:
    record = record_of(drives["hilly"])
    record = record.select(np.arange(record.windows) % 4 == 0)
    setting = Setting(replace(record, lap=held_out_in_turn(record.windows)), "per_axle", PRIOR)
    banked = fit_names(setting, ("road_bank",), None)
    (bank,) = (b.parameters for b in banked.predictor.blocks if b.effect.name == "road_bank")
    assert np.abs(by_zero(banked)[0, bank]).mean() == pytest.approx(ZERO_ERROR / GRAVITY, rel=0.3)
    assert not len(by_zero(pair))
    assert not len(by_zero(fit_names(setting, ("road_bank", "imu_bias"), None)))


@pytest.mark.parametrize(("step", "fitted"), [(0.04, True), (0.02, True), (0.01, False), (0.005, False)])
def test_when_an_accelerometer_was_read_is_fitted_in_logs_slower_than_it(step: float, fitted: bool) -> None:
    assert ("ay_within_a_sample" in {e.name for e in sampling_effects(step, frozenset())}) == fitted


def test_of_sizes_that_are_not_there_none_is_told_from_nothing_in_nineteen_logs_of_twenty(pair: Fit) -> None:
    candidates = [block.effect for block in pair.predictor.blocks]
    sizes = np.random.default_rng(4).normal(size=(40_000, sum(len(e.parameters) for e in candidates)))
    assert np.mean(np.abs(sizes).max(axis=1) > critical_errors(candidates)) == pytest.approx(FALSE_ALARM, rel=0.1)


def test_an_effect_is_told_from_nothing_by_the_error_that_is_stated_of_it(pair: Fit) -> None:
    names, least = ("aero_drag", "steer_offset"), 3.0
    (drag,) = (b.parameters.start for b in pair.predictor.blocks if b.effect.name == "aero_drag")
    for moved, named in ((0.0, names), (0.1, names), (0.5, names[1:]), (-0.5, names[1:])):
        there = pair.parameters.copy()
        there[drag] *= 1.0 + moved
        stated = covariance(pair, Fit(pair.predictor, there, pair.normal, pair.noise))
        assert set(names) - set(insignificant(pair, stated, names, least)) == set(named)


def test_a_constant_that_a_spline_takes_back_is_as_small_as_both_are_together(drives: dict[str, Any]) -> None:
    record = record_of(drives["single"])
    record = record.select(np.arange(record.windows) % 6 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 4), "per_axle", PRIOR)
    base = fit_names(setting, ["rolling_resistance"], None)
    basis, mass = record.bases["drive"], record.vehicle.mass
    term = Term("force_x", "drive", basis, compare(*[base.held_out()] * 2, base.normal.count))
    done = fit_names(term.added_to(setting), ["rolling_resistance"], base)
    rolling, spline = (next(b.parameters for b in done.predictor.blocks if b.effect.name == name)
                       for name in ("rolling_resistance", term.effect.name))  # fmt: skip
    drive = record.signals["drive"][record.rows].ravel()
    for coasting, smallest in ((400.0, 0.0), (-200.0, 400.0)):
        parameters = done.parameters.copy()
        parameters[rolling] = 400.0
        back = np.linalg.lstsq(basis.matrix(drive), np.where(drive < 0.0, coasting / mass, 0.0), rcond=None)[0]
        parameters[spline] = back
        beside = replace(done, parameters=parameters)
        assert taken_back(beside)[rolling][0] == pytest.approx(smallest, abs=60.0)
        assert np.sqrt(covariance(beside)[rolling, rolling][0, 0]) > 400.0 - smallest - 60.0
