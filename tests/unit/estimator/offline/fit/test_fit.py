"""The fit: derivatives, agreement with an independent simulation, bounds, outliers, methods, coverage."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from support.drives.drive_simulator import TYRE, Drive, accelerations, random_tyres, simulate

from estimator.drive_log.table import DriveLog, segment_numbers
from estimator.model.columns import CHANNELS, Columns, ModelColumns
from estimator.model.effects import catalogue
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from estimator.offline.fit.coordinates import StepCoordinates
from estimator.offline.fit.equation_error import fit, residuals, rmse
from estimator.offline.fit.gauss_newton import bounded_step
from estimator.offline.fit.identifiability import analyse
from estimator.offline.fit.output_error import OutputErrorProblem, OutputErrorSettings, fit_output_error
from estimator.offline.fit.recursive import averaged, batch, sample
from estimator.offline.predict.nuisance import steer_timing, vy_sensor
from estimator.offline.record.declared import default_tyre_prior
from estimator.offline.record.prepare import prepare
from hil_gateway.car.car import load_car

VEHICLE = load_car().vehicle
PRIOR = default_tyre_prior("per_axle", VEHICLE, load_car())
NAMES = tuple(TYRE)


def as_log(drive: Drive) -> DriveLog:
    return DriveLog(columns=drive.columns, segment=segment_numbers(drive.columns["t"]))


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate([TYRE], 60.0, seed=5)[0]


@pytest.fixture(scope="module")
def columns() -> ModelColumns:
    return ModelColumns(SingleTrack(VEHICLE, PRIOR, (steer_timing(0.01),)))


def test_columns_agree_with_casadi_on_every_effect() -> None:
    model = SingleTrack(
        VEHICLE, tyre_prior(load_car(), "per_axle"), tuple(e for e in catalogue().values() if not e.profile)
    )
    columns = ModelColumns(model)
    inputs, theta, channels = columns.expressions
    reference = ca.Function("reference", [inputs, theta], [channels])
    rng = np.random.default_rng(1)
    values = rng.uniform(0.1, 1.0, (inputs.numel(), 300))
    values[0] += 20.0
    point = columns.start * rng.uniform(0.9, 1.1, len(columns.start))
    predicted = columns.predict(values, point)
    for i in range(0, 300, 7):
        assert np.allclose(predicted[:, i], np.array(reference(values[:, i], point)).ravel(), rtol=1e-10, atol=1e-12)


def test_unknown_instruction_is_refused_not_ignored() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError):
        Columns(ca.Function("f", [x], [ca.erf(x)]))


def test_predictions_agree_with_an_independent_simulation(drive: Drive) -> None:
    log = as_log(simulate([TYRE], 10.0, seed=1, noise=0.0)[0])
    samples = prepare(log, smooth=False)
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    theta = np.array([TYRE[p.name] for p in columns.parameters])
    errors = residuals(columns, samples, theta, ("ax", "ay"))
    assert np.abs(errors).max() < 0.02  # the smooth blend of the slip angles at low speed


def test_derivatives_agree_with_finite_differences(drive: Drive, columns: ModelColumns) -> None:
    samples = prepare(as_log(drive)).select_range(0, 1000)
    theta = columns.start * 1.1 + 1e-3
    _, _, J = next(columns.linearise(samples.inputs, theta))
    J = J.copy()
    for i in range(len(theta)):
        h = 1e-6 * max(abs(theta[i]), 1e-2)
        up, down = theta.copy(), theta.copy()
        up[i] += h
        down[i] -= h
        numeric = (columns.predict(samples.inputs, up) - columns.predict(samples.inputs, down)) / (2.0 * h)
        assert np.abs(J[:, i] - numeric).max() <= 1e-6 * max(1.0, np.abs(numeric).max())


def test_simulated_sensitivities_agree_with_finite_differences(drive: Drive) -> None:
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR, (steer_timing(0.01), vy_sensor())))
    log = as_log(drive)
    problem = OutputErrorProblem(columns, log, prepare(log).select_range(0, 2000), OutputErrorSettings())
    theta = np.array([TYRE.get(p.name, 0.01) for p in columns.parameters])
    start = problem.starts.near(problem.scaled(theta))
    run = problem.simulator.run(problem.windows, start, theta)
    assert run.by_theta is not None
    for i in range(len(theta)):
        h = 1e-4 * max(abs(theta[i]), 1e-2)
        up, down = theta.copy(), theta.copy()
        up[i] += h
        down[i] -= h
        outputs = [problem.simulator.run(problem.windows, start, p, sensitivities=False).outputs for p in (up, down)]
        numeric = (outputs[0] - outputs[1]) / (2.0 * h)
        assert np.abs(run.by_theta[:, i] - numeric).max() <= 0.02 * np.abs(numeric).max() + 1e-6


def test_output_error_recovers_the_tyres_within_their_intervals(drive: Drive, columns: ModelColumns) -> None:
    log = as_log(drive)
    samples = prepare(log)
    start = fit(columns, averaged(samples)).theta
    settings = OutputErrorSettings(outputs=("vy", "yaw_rate", "ay"))
    result = fit_output_error(columns, log, samples, settings, [columns.start, start])
    for name, truth in TYRE.items():
        assert abs(result.values[name] - truth) < 3.3 * result.std[name], name
    for axle in "fr":
        stiffness, right = (np.prod([v[f"{x}{axle}"] for x in "bcd"]) for v in (result.values, TYRE))
        assert stiffness == pytest.approx(right, rel=0.02)


def test_recursions_agree_with_the_full_fit_within_their_uncertainty(drive: Drive) -> None:
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    samples = averaged(prepare(as_log(drive)))
    full = fit(columns, samples)
    for method in (batch, sample):
        recursion = method(columns, samples, samples)
        for name in NAMES:
            apart = abs(recursion.fit.values[name] - full.values[name])
            assert apart < 3.0 * np.hypot(recursion.fit.std[name], full.std[name]), (method.__name__, name)


def test_batch_curves_fall_and_level_off_as_in_figure_4(drive: Drive) -> None:
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    samples = prepare(as_log(drive))
    result = batch(columns, samples, averaged(samples))
    for channel in ("ax", "ay"):
        for curve in (result.curve, result.as_published):
            values = np.array([point.rmse[channel] for point in curve])
            tail = values[-len(values) // 4 :]
            assert values[-1] < 0.5 * values[0]
            assert np.ptp(tail) < 0.25 * (values[0] - values[-1])


@pytest.mark.parametrize("method", [batch, sample])
def test_a_curve_begins_at_the_initial_parameters_and_ends_at_those_reported(method: Any, drive: Drive) -> None:
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    samples = averaged(prepare(as_log(drive)))
    result = method(columns, samples, samples)
    for point, theta in ((result.curve[0], columns.start), (result.curve[-1], result.fit.theta)):
        assert point.rmse == rmse(columns, samples, theta, tuple(point.rmse))


def test_a_published_batch_counts_for_one_sample(drive: Drive) -> None:
    """It learns more slowly than a batch that counts for all it holds."""
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    samples = averaged(prepare(as_log(drive)))
    result = batch(columns, samples, samples)
    published, refined = (curve[1].rmse["ay"] for curve in (result.as_published, result.curve))
    assert published > refined + 0.2 * result.curve[0].rmse["ay"]


def test_outliers_do_not_move_the_estimate(drive: Drive, columns: ModelColumns) -> None:
    clean = averaged(prepare(as_log(drive)))
    spoilt = averaged(prepare(as_log(drive)))
    spoilt.channels[1, ::100] += 30.0
    before, after = fit(columns, clean), fit(columns, spoilt)
    for name in NAMES:
        assert abs(after.values[name] - before.values[name]) < 2.0 * before.std[name] + 0.02 * before.values[name]


def test_spins_are_left_out_with_the_time_around_them(drive: Drive) -> None:
    vy = drive.columns["vy"].copy()
    vy[2000:2040] = 0.7 * drive.columns["vx"][2000:2040]
    log = as_log(replace(drive, columns={**drive.columns, "vy": vy}))
    left_out = np.setdiff1d(prepare(as_log(drive)).row, prepare(log).row)
    assert (left_out[0], left_out[-1]) == (1950, 2089)


def test_estimate_stays_within_bounds_and_says_so() -> None:
    log = as_log(simulate([{**TYRE, "cf": 2.0, "df": 1.0}], 40.0, seed=8)[0])
    prior = {**PRIOR, "bf": 60.0, "df": 0.2}
    columns = ModelColumns(SingleTrack(VEHICLE, prior))
    result = fit(columns, averaged(prepare(log)))
    for parameter, value in zip(result.parameters, result.theta, strict=True):
        assert parameter.lower <= value <= parameter.upper
        distance = min(value - parameter.lower, parameter.upper - value) / (parameter.upper - parameter.lower)
        assert distance > 0.0 or parameter.name in result.at_bound
        assert distance < 0.01 or parameter.name not in result.at_bound
    assert result.at_bound


def test_bounded_step_never_leaves_the_box_and_descends_once_damped() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        A = rng.standard_normal((5, 5))
        H, g = A @ A.T + 0.1 * np.eye(5), rng.standard_normal(5) * 3.0
        u = rng.uniform(-1.0, 1.0, 5)
        box = (np.full(5, -1.0), np.full(5, 1.0))
        for damping in (1e-6, 1e3):
            step = bounded_step(H, g, u, box, damping)
            assert np.all(np.abs(u + step) <= 1.0 + 1e-12)
        assert g @ step + 0.5 * step @ H @ step <= 1e-9


def test_step_coordinates_are_inverse_and_their_tangent_is_right() -> None:
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    slips = {"f": np.array([0.01, 0.04, 0.09]), "r": np.array([0.01, 0.03, 0.08])}
    coordinates = StepCoordinates(columns.parameters, slips)
    u = np.random.default_rng(2).uniform(-0.5, 0.5, len(columns.parameters))
    for point in (u, np.where(np.arange(len(u)) == 2, (2.9 - 1.35) / 0.54, u)):  # the second has C on its bound
        local = coordinates.about(point)
        w = np.random.default_rng(3).uniform(-2e-4, 2e-4, len(u))
        assert np.allclose(local.displacement(local.moved(w)), w, atol=1e-8)
        for i in range(len(u)):
            h = np.zeros(len(u))
            h[i] = 1e-6
            numeric = (local.moved(h) - local.moved(-h)) / 2e-6
            assert np.allclose(local.tangent()[:, i], numeric, rtol=1e-4, atol=1e-5)


def test_thinning_keeps_the_mean_and_never_crosses_a_gap(drive: Drive) -> None:
    columns = {n: c.copy() for n, c in drive.columns.items()}
    columns["t"][3000:] += 10.0
    samples = prepare(DriveLog(columns=columns, segment=segment_numbers(columns["t"])))
    thin = samples.thin(7)
    assert np.all(np.diff(thin.segment) >= 0)
    assert abs(len(thin) * 7 - len(samples)) < 14
    assert thin["ay"].mean() == pytest.approx(samples["ay"].mean(), abs=0.02)


def test_gentle_driving_cannot_tell_b_c_and_d_apart_and_says_how_much_slip_would() -> None:
    log = as_log(simulate([TYRE], 60.0, seed=5)[0])
    gentle = log.select(np.abs(log["ay"]) < 3.0)
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR))
    samples = averaged(prepare(log)).select(np.abs(averaged(prepare(log))["ay"]) < 2.5)
    known = analyse(fit(columns, samples), samples, VEHICLE, "per_axle")
    assert len(gentle) > 0
    assert not known.identifiable["cf"]
    assert known.identifiable["cx"]
    text = " ".join(known.statements)
    assert "front axle cannot be separated" in text
    assert "would separate them" in text


@pytest.mark.slow
def test_intervals_cover_the_truth() -> None:
    drives = simulate(random_tyres(10, seed=11), 45.0, seed=12)
    columns = ModelColumns(SingleTrack(VEHICLE, PRIOR, (steer_timing(0.01),)))
    inside = []
    for one in drives:
        result = fit(columns, averaged(prepare(as_log(one))))
        inside += [abs(result.values[n] - one.tyre[n]) < 1.96 * result.std[n] for n in NAMES]
    assert np.mean(inside) > 0.85


def test_channels_of_the_evaluation_are_those_of_the_samples(drive: Drive) -> None:
    samples = prepare(as_log(drive))
    assert samples.channels.shape[0] == len(CHANNELS)
    ax, ay, yaw_acc = accelerations(
        samples.inputs[:3], samples["steer"], samples["drive"], {n: np.array(v) for n, v in TYRE.items()}
    )
    assert np.std(samples.channels[1] - ay) < 0.3
    assert np.std(samples.channels[2] - yaw_acc) < 0.2
    assert np.std(samples.channels[0] - ax) < 0.2
