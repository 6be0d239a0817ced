"""What a diagnosis promises, on drives simulated by equations that are not the estimator's."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import PRIOR, record_of
from support.examples import run_example
from support.once import once
from typer.testing import CliRunner

from estimator.belief.revision import model_of
from estimator.drive_log.smoothing import second_difference_noise
from estimator.drive_log.table import DriveLog
from estimator.model.basis import Basis, make_basis
from estimator.model.single_track import SingleTrack
from estimator.offline.diagnosis import Diagnosis, diagnose
from estimator.offline.fit.normal import Normal
from estimator.offline.fit.prediction_error import CONVERGED
from estimator.offline.fit.steps import Coordinates
from estimator.offline.record.derivative import kernel
from estimator.offline.record.laps import scored_laps
from estimator.offline.report.diagnosis_result import as_json, as_revision, sizes_of
from estimator.offline.report.unexplained import unexplained
from estimator.offline.report.words import describe, follows_turn_direction, parameter_words, verdict_sentence
from estimator.offline.result.diagnosis_score import noise_floor, rmse
from estimator.offline.result.leftover import EXPLAINS, Leftover, comes_back, leftovers
from estimator.offline.result.uncertainty import covariance
from estimator.offline.search.acceptance import BEYOND_NOISE
from estimator.offline.search.plausible import believed, possible
from estimator.offline.search.trial import Setting, Trial, fit_names
from hil_gateway.car.car import load_car
from hil_gateway.process.figures import figure


@pytest.fixture(scope="module")
def diagnosed(drives: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Diagnosis]:
    done: dict[str, Diagnosis] = {}

    def get(name: str) -> Diagnosis:
        if name not in done:
            record = record_of(drives[name])
            done[name] = once(tmp_path_factory, f"diagnosis_{name}", lambda: diagnose(record, "per_axle", PRIOR))
        return done[name]

    return get


def test_nothing_missing_is_called_none(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("none")
    assert found.verdict == "none"
    for channel in ("ax", "ay"):
        row = found.channels[channel]
        assert row["with_effects"] < 1.1 * row["noise_floor"]


def test_single_effect_is_named_alone_with_its_size(diagnosed: Callable[[str], Diagnosis]) -> None:
    result = as_json(diagnosed("single"), "r", "")
    assert result["verdict"] == "effect"
    assert [e["name"] for e in result["effects"]] == ["rolling_resistance"]
    force = result["effects"][0]["parameters"]["force"]
    assert abs(force["value"] - 420.0) < min(42.0, 3 * force["std"])
    assert result["effects"][0]["confidence"] > 0.95
    assert result["channels"]["ax"]["with_effects"] < 1.1 * result["channels"]["ax"]["noise_floor"]


def test_a_parameter_that_the_data_do_not_tell_is_said_to_be_undetermined(
    diagnosed: Callable[[str], Diagnosis], drives: dict[str, Any]
) -> None:
    setting = Setting(record_of(drives["single"]), "per_axle", PRIOR)  # no throttle is recorded, so no pedal acts
    done = fit_names(setting, ["rolling_resistance", "engine_braking"], None)
    found = replace(diagnosed("single"), fit=done)
    sizes = {b.effect.name: sizes_of(found, b, covariance(found.fit)) for b in done.predictor.blocks}
    assert parameter_words("pedal", sizes["engine_braking"]["pedal"]) == "pedal undetermined"
    assert parameter_words("force", sizes["rolling_resistance"]["force"]).startswith("force 4")


def test_pair_is_named_whole(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("pair")
    assert set(found.accepted) == {"aero_drag", "steer_offset"}
    json.dumps(as_json(found, "r", ""), allow_nan=False)


def test_an_effect_whose_size_is_not_told_from_nothing_is_no_finding(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("pair")
    (drag,) = (b.parameters for b in found.fit.predictor.blocks if b.effect.name == "aero_drag")
    moved = found.fit.parameters.copy()
    moved[drag] = 0.0  # without a spline the fit would find none of it
    unsure = replace(found, without_splines=replace(found.fit, parameters=moved))
    result = as_json(unsure, "r", "")
    assert result["verdict"] == "unexplained"
    assert [e["name"] for e in result["effects"]] == ["steer_offset"]
    assert [e["name"] for e in result["not_told"]] == ["aero_drag"]
    assert {(u["channel"], u["signal"]) for u in result["unexplained"]} == {("ax", "vx"), ("vx_dot", "vx")}
    assert "Not told from nothing: aero_drag" in verdict_sentence(result)
    assert verdict_sentence(result).startswith("Found: steer_offset")
    assert "aero_drag" in [e.name for e in as_revision(unsure, "per_axle", ()).effects]


def test_a_wrong_yaw_inertia_is_reported_as_declared_data_and_not_as_an_effect(drives: dict[str, Any]) -> None:
    wrong = load_car().vehicle.model_copy(update={"yaw_inertia": 0.85 * load_car().vehicle.yaw_inertia})
    record = replace(record_of(drives["none"]), vehicle=wrong)
    result = as_json(diagnose(record, "per_axle", PRIOR), "r", "")
    assert result["effects"] == []
    assert [v["name"] for v in result["vehicle"]] == ["yaw_inertia"]
    found = result["vehicle"][0]
    assert found["declared"] == wrong.yaw_inertia
    true = load_car().vehicle.yaw_inertia
    assert abs(found["found"] - true) < min(3.0 * found["std"], 0.05 * true)


def test_wheels_that_follow_by_a_first_order_lag_are_named_with_its_time_constant(
    diagnosed: Callable[[str], Diagnosis],
) -> None:
    result = as_json(diagnosed("lag"), "r", "")
    assert (result["verdict"], [e["name"] for e in result["effects"]]) == ("effect", ["steer_delay"])
    found = result["effects"][0]
    assert found["form"] == "steer_lag"
    assert found["parameters"]["time_constant"]["value"] == pytest.approx(0.08, abs=0.006)


def test_wheels_that_swing_are_unexplained_steering_and_no_delay(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("swing")
    block = next(b for b in found.fit.predictor.blocks if b.effect.name == "steer_swing")
    assert found.fit.parameters[block.parameters] == pytest.approx([0.25, 0.2], rel=0.1), "4 Hz, damping 0.2"
    result = as_json(found, "r", "")
    assert (result["verdict"], result["effects"]) == ("unexplained", [])
    first = result["unexplained"][0]
    assert (first["channel"], first["signal"], first["term"]) == ("yaw_acc", "steer", "steer_swing")
    assert result["channels"]["yaw_acc"]["with_effects"] < 1.1 * result["channels"]["yaw_acc"]["noise_floor"]
    assert result["channels"]["yaw_acc"]["catalogue"] > 1.25 * result["channels"]["yaw_acc"]["noise_floor"]


@pytest.mark.long
def test_grip_that_falls_with_the_heat_of_the_tyres_is_no_drift(diagnosed: Callable[[str], Diagnosis]) -> None:
    result = as_json(diagnosed("heat"), "r", "")
    assert (result["verdict"], result["effects"]) == ("unexplained", [])
    first = result["unexplained"][0]
    assert (first["channel"], first["signal"], first["term"]) == ("vy_dot", "ay", "tyre_heat")


@pytest.mark.parametrize(
    ("drive", "signal", "term", "parameters"),
    [
        pytest.param("gyro", "yaw_rate", "gyro_gain", {"gain": 1.04}, marks=pytest.mark.long),
        pytest.param("stiffer", "t", "stiffness_drift", {}, marks=pytest.mark.long),
        ("dragging", "t", "brake_drag", {"time_constant": 4.0, "kept": 700.0 / (0.05 * 62e3)}),
        pytest.param("bent", "drive", "drive_curve", {"exponent": 0.25, "gain": 1.0}, marks=pytest.mark.long),
    ],
)
def test_what_resembles_an_effect_is_unexplained_with_its_own_numbers(
    diagnosed: Callable[[str], Diagnosis], drive: str, signal: str, term: str, parameters: dict[str, float]
) -> None:
    found = diagnosed(drive)
    result = as_json(found, "r", "")
    assert (result["verdict"], result["effects"]) == ("unexplained", [])
    first = result["unexplained"][0]
    assert (first["signal"], first["term"]) == (signal, term)
    block = next(b for b in found.fit.predictor.blocks if b.effect.name == term)
    names = [p.name for p in block.effect.parameters]
    sizes = dict(zip(names, found.fit.parameters[block.parameters], strict=True))
    assert {name: sizes[name] for name in parameters} == pytest.approx(parameters, rel=0.1)


def test_what_comes_and_goes_is_said_of_time_and_not_of_a_heading_that_goes_on(drives: dict[str, Any]) -> None:
    record = record_of(drives["none"])
    t, measured = record.signals["t"], record.measured.copy()
    starts = np.cumsum(np.random.default_rng(7).uniform(35.0, 60.0, 40))
    there = np.any((t[:, None] > starts) & (t[:, None] < starts + 15.0), axis=1)
    measured[0] += 0.5 * there
    turning = {**record.signals, "yaw": 2.0 * np.pi * t / 70.0}  # as on an oval
    result = as_json(diagnose(replace(record, measured=measured, signals=turning), "per_axle", PRIOR), "r", "")
    assert (result["verdict"], result["effects"]) == ("unexplained", [])
    assert {(u["channel"], u["signal"]) for u in result["unexplained"]} == {("ax", "t")}


@pytest.mark.long
def test_a_force_along_the_car_does_not_hide_a_wrong_yaw_inertia(drives: dict[str, Any]) -> None:
    wrong = load_car().vehicle.model_copy(update={"yaw_inertia": 1.2 * load_car().vehicle.yaw_inertia})
    record = replace(record_of(drives["none"]), vehicle=wrong)
    measured = record.measured.copy()
    measured[3] += 0.02 * np.sin(2.0 * np.pi * 1.1 * record.signals["t"])
    result = as_json(diagnose(replace(record, measured=measured), "per_axle", PRIOR), "r", "")
    assert [v["name"] for v in result["vehicle"]] == ["yaw_inertia"]


def test_a_law_of_the_motion_comes_back_at_its_place_and_a_gust_does_not(drives: dict[str, Any]) -> None:
    record = record_of(drives["none"])
    rows = np.sort(record.rows.ravel())[::20]
    gusts = np.convolve(np.random.default_rng(5).normal(size=len(rows)), np.ones(5), "same")
    assert comes_back(record, rows, record.signals["ay"][rows]) > 0.8
    assert abs(comes_back(record, rows, gusts)) < EXPLAINS


def test_what_exceeds_the_noise_only_in_the_scored_laps_is_said_with_its_time(
    diagnosed: Callable[[str], Diagnosis],
) -> None:
    found = diagnosed("none")
    assert found.leftover == ()
    record, best = found.record, found.models["with_effects"]
    t = record.signals["t"]
    begins = float(t[record.rows[record.lap == record.lap.max()]].min()) + 10.0
    measured = record.measured.copy()
    measured[1] += 0.4 * ((t > begins) & (t < begins + 20.0))
    changed = replace(record, measured=measured)
    floor = {c: row["noise_floor"] for c, row in found.channels.items()}
    left = leftovers(changed, found.test_rows, best.model, best.parameters, floor)
    assert [entry.channel for entry in left] == ["ay"]
    assert left[0].only_scored
    assert left[0].signal == "t"
    (start, end), *_ = left[0].spans
    assert abs(start - begins) < 6.0
    assert abs(end - begins - 20.0) < 6.0


def test_a_size_that_ends_on_its_bound_or_within_its_error_is_not_believed(
    diagnosed: Callable[[str], Diagnosis],
) -> None:
    done = diagnosed("single").fit
    row = next(b.parameters.start for b in done.predictor.blocks if b.effect.name == "rolling_resistance")
    assert believed(done, "rolling_resistance")
    for size in (done.predictor.table[row].upper, 0.002):
        parameters = done.parameters.copy()
        parameters[row] = size
        assert not believed(replace(done, parameters=parameters), "rolling_resistance")


@pytest.mark.parametrize("force", [4500.0, 8000.0])
def test_the_largest_drive_force_of_a_race_car_is_possible(diagnosed: Callable[[str], Diagnosis], force: float) -> None:
    record = diagnosed("single").fit.predictor.record
    done = fit_names(Setting(record, "per_axle", PRIOR), ["drive_saturation"], None, iterations=0)
    (block,) = (b for b in done.predictor.blocks if b.effect.name == "drive_saturation")
    parameters = done.parameters.copy()
    parameters[block.parameters] = force
    assert possible(replace(done, parameters=parameters), block)


@pytest.mark.parametrize("wanted", [-1e9, 1e9])
def test_a_step_of_a_parameter_over_decades_stays_within_half_of_it(wanted: float) -> None:
    ones = np.ones((5, 1))
    normal = Normal(
        ones, wanted * np.ones((5, 1, 1)), np.ones((5, 1, 1, 1)), np.ones(1), np.zeros((1, 1)), np.zeros(1), ones[:, 0]
    )
    coordinates = Coordinates.of([], np.array([500.0]), np.array([1e7]))
    (stepped,), _ = coordinates.damped_step(normal, np.array([9000.0]), 1e-4)
    assert 0.5 < stepped / 9000.0 < 1.5
    assert (stepped > 9000.0) == (wanted > 0.0)


@pytest.mark.parametrize("pull", [-0.35, 0.35])
def test_a_step_in_the_shape_of_a_tyre_keeps_its_stiffness_and_how_its_force_bends(pull: float) -> None:
    b, c, d = 12.0, 1.5, 1.6
    coordinates = Coordinates.of(["b", "c", "d"], np.full(3, 0.01), np.full(3, 100.0))
    bend = c**2 / (2 + c**2)
    known = np.array([[1 / b, 1 / c, 1 / d], [0.0, 1 / c, 0.0], [1 / b, bend / c, 0.0]])  # logarithms by b, c, d
    hessian = known.T @ np.diag([1e6, 1.0, 1e6]) @ known
    normal = Normal(
        np.ones((5, 1)), np.tile(pull * known[1], (5, 1, 1)), np.tile(hessian, (5, 1, 1, 1)), np.ones(1),
        np.zeros((3, 3)), np.zeros(3), np.ones(5),
    )  # fmt: skip
    (b1, c1, d1), _ = coordinates.damped_step(normal, np.array([b, c, d]), 1e-6)
    assert abs(np.log(c1 / c)) > 0.3
    assert b1 * c1 * d1 == pytest.approx(b * c * d, rel=1e-3)
    assert b1 * np.sqrt(2 + c1**2) == pytest.approx(b * np.sqrt(2 + c**2), rel=1e-3)


def test_an_exact_fit_ends_where_no_step_would_lower_the_deviance(diagnosed: Callable[[str], Diagnosis]) -> None:
    fit = diagnosed("pair").fit
    coordinates = Coordinates.of([p.name for p in fit.predictor.model.tyre_table], *fit.predictor.bounds)
    _, fall = coordinates.damped_step(fit.normal, fit.parameters, 0.0)
    assert fall < CONVERGED[0]


def test_without_lateral_sensors_the_lateral_tyre_stays_at_its_prior(drives: dict[str, Any]) -> None:
    record = record_of(drives["single"])
    forward = replace(record, used=np.array([False, False, False, True, False]), lap=np.arange(record.windows) // 15)
    found = fit_names(Setting(forward, "per_axle", PRIOR), (), None)
    tyre = dict(zip((p.name for p in found.predictor.model.tyre_table), found.parameters, strict=False))
    assert {n: v for n, v in tyre.items() if n != "cx"} == {n: v for n, v in PRIOR.items() if n != "cx"}
    assert tyre["cx"] != PRIOR["cx"]


def test_effect_outside_the_catalogue_is_unexplained_and_located(diagnosed: Callable[[str], Diagnosis]) -> None:
    result = as_json(diagnosed("outside"), "r", "")
    assert result["verdict"] == "unexplained"
    assert not result["effects"], "nothing of the catalogue acts"
    assert {(u["channel"], u["signal"]) for u in result["unexplained"]} & {
        ("ay", "track_position"), ("vy_dot", "track_position"),
    }  # fmt: skip
    row = result["channels"]["ay"]
    assert row["refit"] - row["with_effects"] > 0.6 * (row["refit"] - row["noise_floor"])


def test_what_is_left_comes_before_a_term_that_explains_less_and_after_any_other(
    diagnosed: Callable[[str], Diagnosis],
) -> None:
    found = diagnosed("outside")
    left = (Leftover("ay", 4.0, False, "t", ((100.0, 120.0),), (0.0, 370.0)),)
    for after, order in ((0.5, ["t", "track_position"]), (0.2, ["track_position", "t"])):
        channels = {
            c: {**row, "catalogue": 0.6, "with_effects": after, "noise_floor": 0.15}
            for c, row in found.channels.items()
        }
        said = unexplained(replace(found, leftover=left, channels=channels))
        assert [u["signal"] for u in said if u["channel"] == "ay"] == order


def test_test_laps_are_kept_from_every_fit(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("single")
    assert not set(found.train_laps) & set(found.test_laps)
    learnt = set(np.unique(found.fit.predictor.record.rows).tolist())
    assert not learnt & set(found.test_rows.tolist())


def test_revision_rebuilds_the_diagnosed_model(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("single")
    revision = as_revision(found, "per_axle", ("hash",))
    rebuilt = model_of(revision, load_car().vehicle, 1000.0)
    assert [e.name for e in rebuilt.model.effects] == ["rolling_resistance"]
    std = np.sqrt(np.diag(found.fit.covariance))[:7]
    assert np.all(np.abs(rebuilt.theta - found.fit.parameters[:7]) < 2.0 * std), (
        "all is explained: handed over as found"
    )
    assert revision.provenance.error_after["ax"] < revision.provenance.error_before["ax"]


def test_report_is_one_page_without_network(
    diagnosed: Callable[[str], Diagnosis], drives: dict[str, Any], tmp_path: Path
) -> None:
    from estimator.offline.report.diagnosis_report import write_report

    found = diagnosed("single")
    columns = drives["single"].columns
    log = DriveLog(columns, np.zeros(len(columns["t"]), np.int64), sources={"drive.csv": "abc"})
    page = write_report(found, as_json(found, "r", ""), log, tmp_path / "report.html").read_text()
    assert "rolling_resistance" in page
    assert "<script src" not in page
    assert "<link" not in page


@pytest.mark.parametrize(("laps", "scored"), [(3, (2,)), (5, (1, 4)), (8, (1, 4, 7)), (20, (1, 4, 7, 10, 13, 16, 19))])
def test_which_laps_are_scored_follows_from_their_numbers_alone(laps: int, scored: tuple[int, ...]) -> None:
    assert scored_laps(np.repeat(np.arange(laps), 40), has_laps=True) == scored


def test_what_scored_laps_hold_changes_nothing_that_a_fit_is_given(drives: dict[str, Any]) -> None:
    drive = drives["none"]
    lap = drive.columns["lap"]
    scored = np.isin(lap, scored_laps(lap.astype(np.int64), has_laps=True))
    rng = np.random.default_rng(5)
    worse = {n: drive.columns[n] + scored * rng.normal(0.0, 1.0, len(lap)) for n in ("ax", "ay")}
    worse["vx"] = drive.columns["vx"] + 3.0 * scored
    plain, other = record_of(drive), record_of(replace(drive, columns=drive.columns | worse))
    assert other.noise == pytest.approx(plain.noise, rel=0.02)
    assert other.lap_length == pytest.approx(plain.lap_length)
    assert other.bases["vx"].knots == pytest.approx(plain.bases["vx"].knots, abs=0.05)


def test_what_comes_and_goes_is_said_of_time(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("none")
    best, measured, t = found.models["with_effects"], found.record.measured.copy(), found.record.signals["t"]
    begins = np.cumsum(np.random.default_rng(3).uniform(15.0, 45.0, 14))
    measured[1] += 1.2 * np.any((t > begins[:, None]) & (t < begins[:, None] + 1.5), axis=0)
    floor = {c: row["noise_floor"] for c, row in found.channels.items()}
    changed = replace(found.record, measured=measured)
    (left,) = leftovers(changed, found.test_rows, best.model, best.parameters, floor)
    assert (left.channel, left.signal) == ("ay", "t")
    assert all(np.any((begins > a - 5.0) & (begins < b + 5.0)) for a, b in left.spans)


@pytest.mark.parametrize(("drive", "there"), [("play", True), ("none", False)])
def test_play_in_the_steering_is_found_where_it_is_with_its_size(
    drives: dict[str, Any], drive: str, there: bool
) -> None:
    record = record_of(drives[drive])
    record = record.select(np.arange(record.windows) % 12 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 4), "per_axle", PRIOR)
    done = fit_names(setting, ["steer_play"], None)
    assert believed(done, "steer_play") == there
    row = next(b.parameters.start for b in done.predictor.blocks if b.effect.name == "steer_play")
    assert done.parameters[row] == pytest.approx(drives[drive].effects.get("steer_play", 0.0), abs=3e-4)


def test_a_second_form_is_reported_under_the_name_of_the_effect(diagnosed: Callable[[str], Diagnosis]) -> None:
    found = diagnosed("single")
    brakes = {"rolling_resistance": "brake_pressure"}
    done = fit_names(Setting(found.fit.predictor.record, "per_axle", PRIOR), ["brake_pressure"], None)
    told, (block,) = done.parameters.copy(), (b for b in done.predictor.blocks if b.effect.name == "brake_pressure")
    told[block.parameters] = [p.prior + 5.0 * p.prior_std for p in block.effect.parameters]
    done = replace(done, parameters=told)
    renamed = replace(
        found, fit=done, accepted=("brake_pressure",), gains={brakes[n]: g for n, g in found.gains.items()},
        search=replace(
            found.search, look_alikes={"brake_pressure": "engine_braking"},
            rounds=((Trial("brake_pressure", found.gains["rolling_resistance"], done),),),
        ),
    )  # fmt: skip
    (entry,) = as_json(renamed, "", "")["effects"]
    assert (entry["name"], entry["form"], entry["not_told_from"]) == ("front_brake", "brake_pressure", "engine_braking")


def test_windows_in_which_the_car_has_spun_are_left_out(drives: dict[str, Any]) -> None:
    drive = drives["none"]
    spun = np.abs(drive.columns["t"] - 100.0) < 1.0
    columns = drive.columns | {"vy": np.where(spun, 1.5 * drive.columns["vx"], drive.columns["vy"])}
    kept = np.zeros(len(spun), bool)
    kept[record_of(replace(drive, columns=columns)).rows.ravel()] = True
    assert not np.any(kept & spun)
    assert kept.mean() > 0.9


@pytest.mark.parametrize("step", [0.04, 0.02, 0.01, 0.005])
def test_differentiating_kernel_is_the_derivative_of_the_smoothing_one(step: float) -> None:
    smooth, slope = kernel(step, 0.25)
    t = step * np.arange(400)
    wave, rate = np.sin(10 * t), 10 * np.cos(10 * t)
    np.testing.assert_allclose(np.convolve(wave, slope, "valid"), np.convolve(rate, smooth, "valid"), atol=5e-4)


def test_noise_is_measured_beside_a_smooth_signal() -> None:
    rng = np.random.default_rng(9)
    t = 0.01 * np.arange(20_000)
    assert second_difference_noise(5 * np.sin(2 * t) + 0.15 * rng.normal(size=t.size)) == pytest.approx(0.15, rel=0.05)


@pytest.mark.parametrize("signal", ["t", "track_position"])
def test_moved_knots_follow_a_step_and_the_edges_of_a_stretch(signal: str) -> None:
    values = np.linspace(0.0, 3000.0, 60_000)
    truth = (values > 1210.0) * 1.0 if signal == "t" else ((values > 1210.0) & (values < 1330.0)) * 1.0
    basis, errors = make_basis(signal, values, 3000.0), []
    for _ in range(3):
        matrix = basis.matrix(values)
        coefficients = np.linalg.lstsq(matrix, truth, rcond=None)[0]
        errors.append(float(np.sqrt(np.mean((matrix @ coefficients - truth) ** 2))))
        basis = basis.moved(coefficients, values)
    assert errors[2] < 0.4 * errors[0]
    np.testing.assert_allclose(basis.matrix(values).sum(axis=1), 1.0, rtol=1e-12)
    assert np.all(np.linalg.eigvalsh(basis.precision(0.1)) > 0)


def test_words_say_when_a_term_begins() -> None:
    values = np.linspace(0.0, 900.0, 9000)
    basis = make_basis("t", values, 0.0)
    assert "after" in describe(basis, values, (np.array(basis.knots) > 300.0) * -0.1)


def test_numbers_are_written_as_people_write_them() -> None:
    values = (10360.0, 0.0475, 120.4, 2.3e-5, 0.0)
    assert [figure(v, digits=2) for v in values] == ["10000", "0.048", "120", "2.3e-05", "0"]


def test_a_term_that_is_the_same_in_all_right_turns_depends_on_the_turn_direction() -> None:
    rate = np.random.default_rng(4).normal(0.0, 0.3, 20_000)
    fine = Basis("yaw_rate", 7, knots=(-1.5, -0.6, -0.03, -0.02, 0.1, 0.6, 1.5))
    assert follows_turn_direction(fine, rate, np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    assert not follows_turn_direction(fine, rate, np.array(fine.knots))
    assert (
        describe(Basis("turn_direction", 3, knots=(-1.0, 0.0, 1.0)), rate, np.array([2.0, 0.1, 0.0])) == "right turns"
    )


def test_words_say_above_which_value_a_term_acts() -> None:
    values = np.linspace(10.0, 60.0, 4000)
    basis = make_basis("vx", values, 0.0)
    coefficients = (np.array(basis.knots) > 45.0) * 1.0
    assert "above 4" in describe(basis, values, coefficients)


def test_command_refuses_a_layout_it_does_not_know(tmp_path: Path) -> None:
    from estimator.cli.diagnose import app
    from hil_gateway.process.errors import InputError

    result = CliRunner().invoke(app, [str(tmp_path / "x.csv"), "--layout", "nonsense"])
    assert isinstance(result.exception, InputError)


def test_a_pedal_that_chatters_between_the_rows_is_no_more_than_noise_in_the_speed(drives: dict[str, Any]) -> None:
    drive = drives["none"]
    rng, thin = np.random.default_rng(11), slice(None, None, 2)
    chatter = 0.004 * rng.choice([-1.0, 1.0], len(drive.columns["t"]))
    pushed = np.cumsum(chatter) * 0.01 * drive.tyre["cx"] / load_car().vehicle.mass
    columns = drive.columns | {"vx": drive.columns["vx"] + pushed}
    record = record_of(replace(drive, columns={name: column[thin] for name, column in columns.items()}))
    pedal = record.signals["drive"] + chatter[thin]
    chattering = replace(record, signals={**record.signals, "drive": pedal})
    model = SingleTrack(record.vehicle, drive.tyre)
    rows, numbers = np.sort(record.rows.ravel()), np.array([p.prior for p in model.tyre_table])
    left = rmse(chattering, rows, model, numbers)["vx_dot"]
    sensor = second_difference_noise(record.measured[3]) * np.sqrt(np.sum(kernel(record.step, record.kernel_s)[1] ** 2))
    assert left > BEYOND_NOISE * sensor
    floor = noise_floor(chattering, rows, model, numbers)["vx_dot"]
    assert left < floor < BEYOND_NOISE * left, "as if nothing were known of the pedal between the rows"


def test_the_example_prints_a_diagnosis(
    diagnosed: Callable[[str], Diagnosis], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = json.dumps(as_json(diagnosed("single"), "r", "")).encode()
    monkeypatch.setattr("subprocess.run", lambda command, **_: CompletedProcess(command, 0, said))
    run_example("diagnose_my_log", ["drive.csv"], monkeypatch)
    out = capsys.readouterr().out
    assert "rolling_resistance: " in out and "ax       error" in out
