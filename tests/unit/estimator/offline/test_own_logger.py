"""Logs as a car's own logger writes them: banked roads by roll, pedals for a drive, lateral sensors nobody can use."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.drives.drive_simulator import TYRE, simulate
from support.drives.practice_drives import PRIOR, record_of
from typer.testing import CliRunner

from estimator.cli.diagnose import app
from estimator.drive_log.derived import add_missing_channels, derivative, smoothed
from estimator.drive_log.table import DriveLog
from estimator.model.columns import CHANNELS, ModelColumns
from estimator.model.effect import VY_SENSOR
from estimator.model.effects import catalogue
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY, SIGNALS, SingleTrack
from estimator.offline import fit_and_repair
from estimator.offline.health import examine
from estimator.offline.health.lateral_velocity import place_left
from estimator.offline.health.offsets import lag_left
from estimator.offline.identification import Options, identify
from estimator.offline.known_bank import examine_on_its_road
from estimator.offline.predict.fast_car import drive_zero, presses
from estimator.offline.predict.nuisance import YAW_RATE_TIMING, along, known_bank
from estimator.offline.record.record import Record, make_record
from estimator.offline.record.road import find_road
from estimator.offline.record.unknown_inputs import PEDALS
from estimator.offline.search.trial import Setting, fit_names
from estimator.offline.simulated_lateral import (
    identified_laterally,
    lateral_prior,
    repaired_log,
    with_simulated_lateral,
)
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY

LEAN, ZERO = 0.002, 0.012
"""rad per m/s2, and rad"""


def banked(drive: Any, steepest: float, sign: float) -> tuple[DriveLog, np.ndarray]:
    """The drive without accelerometers, on a road that leans into every bend, with its roll in degrees; the bank."""
    c = drive.columns
    curvature = np.convolve(c["yaw_rate"] / c["vx"], np.ones(50) / 50, "same")
    bank = -steepest * np.clip(curvature / np.quantile(np.abs(curvature), 0.9), -1.0, 1.0)
    felt = c["vx"] * c["yaw_rate"] + GRAVITY * np.sin(bank)
    columns = {n: v for n, v in c.items() if n not in ("ax", "ay")}
    columns["roll_logged"] = np.degrees(sign * (bank + LEAN * felt + ZERO))
    segment = np.zeros(len(c["t"]), np.int64)
    complete, derived = add_missing_channels(Path("x.csv"), columns, segment)
    return DriveLog(complete, segment, derived, ("roll_logged",)), bank


def found_bank(record: Record) -> np.ndarray:
    profile = find_road(record)["road_bank"]
    at = record.thin(record.signals["track_position"])
    return record.bases["track_position"].matrix(at.ravel()) @ profile.coefficients


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_steep_bank_is_found_by_the_roll_whatever_its_sign(drives: dict[str, Any], sign: float) -> None:
    log, bank = banked(drives["flat"], 0.3, sign)
    record = make_record(log, load_car().vehicle)
    error = found_bank(record) - record.thin(bank).ravel()
    assert np.std(error) < 0.03
    assert abs(np.mean(error)) < 0.03, "a zero of the sensor cannot be told from a bank of the whole lap"


def test_a_body_that_leans_on_its_springs_is_no_bank(drives: dict[str, Any]) -> None:
    assert find_road(make_record(banked(drives["flat"], 0.0, 1.0)[0], load_car().vehicle)) == {}


def test_a_bank_the_log_shows_is_an_input_and_not_felt(drives: dict[str, Any]) -> None:
    log, bank = banked(drives["flat"], 0.3, 1.0)
    on_its_road = examine_on_its_road(log, load_car().vehicle).log
    assert np.std(on_its_road["known_bank"] - bank) < 0.04
    turning = log["vx"] * log["yaw_rate"]
    added = on_its_road["ay"] - log["ay"] - (smoothed(log["t"], turning, log.segment) - turning)
    assert np.allclose(added, GRAVITY * np.sin(on_its_road["known_bank"]), atol=0.05)
    level, _ = banked(drives["flat"], 0.0, 1.0)
    assert "known_bank" not in examine_on_its_road(level, load_car().vehicle).log


def test_a_known_bank_follows_the_roll_where_it_rises_within_less_than_the_knots_of_a_profile(
    drives: dict[str, Any],
) -> None:
    log, gentle = banked(drives["flat"], 0.3, 1.0)
    record = make_record(log, load_car().vehicle)
    position = record.signals["track_position"]
    place = np.round(position / 5.0).astype(int)
    bank = 0.3 * np.tanh(10.0 * (np.bincount(place, gentle) / np.maximum(np.bincount(place), 1))[place])
    sharp = log.with_columns({"roll_logged": np.degrees(bank)}, "rises within a few metres")
    basis = record.bases["track_position"]
    matrix = basis.matrix(position)
    by_profile = matrix @ np.linalg.lstsq(matrix, bank, rcond=None)[0] - bank
    left = examine_on_its_road(sharp, load_car().vehicle).log["known_bank"] - bank
    assert np.std(left) < 0.75 * np.std(by_profile), "no profile with these knots comes nearer"


@pytest.mark.parametrize("ay_is_derived", [True, False])
def test_another_zero_of_the_bank_pulls_the_car_and_leaves_an_ay_that_was_derived_with_the_bank_found(
    ay_is_derived: bool,
) -> None:
    columns = ModelColumns(
        SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"), (known_bank(ay_is_derived=ay_is_derived),))
    )
    inputs = np.zeros((len(SIGNALS) + len(AUXILIARY), 1))
    inputs[:3, 0] = 50.0, -0.5, 0.2
    inputs[len(SIGNALS) + AUXILIARY.index("known_bank")] = -0.3
    theta = columns.start.copy()
    theta[-1] = 0.02
    channels = columns.predict(inputs, theta)[:, 0]
    felt = channels[CHANNELS.index("vy_dot")] + 50.0 * 0.2
    bank = -0.3 if ay_is_derived else -0.28
    assert channels[CHANNELS.index("ay")] - felt == pytest.approx(GRAVITY * np.sin(bank))


def test_the_measured_acceleration_moves_load_from_the_front_axle_to_the_rear() -> None:
    car, load_transfer = load_car().vehicle, catalogue()["load_transfer"].as_logged
    assert load_transfer is not None
    columns = ModelColumns(SingleTrack(car, tyre_prior(load_car(), "per_axle"), (along(load_transfer),)))
    inputs = np.zeros((len(SIGNALS) + len(AUXILIARY), 2))
    inputs[:4] = np.array([[50.0], [-0.3], [0.2], [0.02]])
    inputs[len(SIGNALS) + AUXILIARY.index("ax")] = 0.0, 5.0
    theta = columns.start.copy()
    theta[-1] = 0.3
    ay, yaw_acc = columns.predict(inputs, theta, ("ay", "yaw_acc"))
    front = (car.mass * car.lr * ay + car.yaw_inertia * yaw_acc) / car.wheelbase
    rear, moved = car.mass * ay - front, 0.3 / car.wheelbase * car.mass * 5.0
    assert front[1] / front[0] == pytest.approx(1.0 - moved / car.static_load_front)
    assert rear[1] / rear[0] == pytest.approx(1.0 + moved / car.static_load_rear)


def test_a_drive_that_is_nothing_where_the_axle_pushes_has_its_zero_estimated() -> None:
    columns = ModelColumns(SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"), (drive_zero(),)))
    inputs = np.zeros((len(SIGNALS) + len(AUXILIARY), 2))
    inputs[:4] = np.array([[50.0], [-0.3], [0.2], [0.02]])
    inputs[SIGNALS.index("drive")] = 0.03, 0.03 - 0.01
    theta = columns.start.copy()
    rolling = columns.predict(inputs[:, 1:], theta)
    theta[-1] = 0.01
    assert np.allclose(columns.predict(inputs[:, :1], theta), rolling)
    assert rolling[0] < columns.predict(inputs[:, 1:], theta - 0.02 * (theta == 0.01))[0], "a negative zero pushes"


def test_the_air_presses_on_axles_at_the_speed_of_ovals_and_hardly_on_road_courses() -> None:
    assert presses(55.0, load_car().vehicle)
    assert not presses(32.0, load_car().vehicle)


def test_zero_and_scales_of_pedals_are_fitted_where_the_drive_comes_from_them(drives: dict[str, Any]) -> None:
    drive = drives["single"]
    command = drive.columns["drive"]
    zero, brake = 0.002, 0.5
    throttle = np.where(command + zero > 0, (command + zero) / 0.1, 0.0)
    full = load_car().powertrain.brake_pressure_max
    pressure = np.where(command + zero < 0, -(command + zero) / brake / 0.3 * full, 0.0)
    columns = {n: c for n, c in drive.columns.items() if n != "drive"} | {"throttle": throttle, "brake": pressure}
    segment = np.zeros(len(command), np.int64)
    complete, derived = add_missing_channels(Path("x.csv"), columns, segment)
    record = make_record(DriveLog(complete, segment, derived), load_car().vehicle)
    assert record.pedals
    setting = Setting(record, "per_axle", PRIOR)
    fit = fit_names(setting, ("rolling_resistance",), fit_names(setting, (), None), exact=True)
    place = next(b for b in fit.predictor.blocks if b.effect.name == PEDALS).parameters.start
    rolling = next(b for b in fit.predictor.blocks if b.effect.name == "rolling_resistance").parameters.start
    assert fit.parameters[place + 1] == pytest.approx(brake, rel=0.05)
    force = fit.parameters[rolling] + fit.parameters[0] * fit.parameters[place]
    assert force == pytest.approx(420.0 + 62000.0 * zero, rel=0.1)
    assert np.sqrt(fit.covariance[rolling, rolling]) > 100.0, "a throttle's zero is a constant force as well"
    assert not record_of(drive).pedals


@cache
def late_drive() -> dict[str, np.ndarray]:
    return simulate([TYRE], 90.0, seed=41)[0].columns


def late(lag: float, *, ay: bool) -> DriveLog:
    """A minute with the yaw rate late and a displaced sensor of vy; with a lateral accelerometer or without."""
    c = dict(late_drive())
    c["yaw_rate"] = np.interp(c["t"] - lag, c["t"], c["yaw_rate"])
    c["vy"] = c["vy"] + 0.014 * c["vx"] + 0.1
    if not ay:
        del c["ay"]
    segment = np.zeros(len(c["t"]), np.int64)
    complete, derived = add_missing_channels(Path("x.csv"), c, segment)
    return DriveLog(complete, segment, derived)


def test_an_accelerometer_is_not_blamed_for_a_late_yaw_rate() -> None:
    health = examine(late(0.3, ay=True), load_car().vehicle)
    assert {"offset_yaw_rate", "offset_vy"} <= {f.name for f in health.findings}
    assert "useless_ay" not in {f.name for f in health.findings}
    assert health.doubtful == (), "what the repair of vy leaves is estimated with the tyres"


def test_what_a_displaced_sensor_of_vy_reports_is_estimated_along_with_the_tyres(drives: dict[str, Any]) -> None:
    c = drives["flat"].columns
    vy = c["vy"] + 0.6 * c["yaw_rate"] + 0.01 * c["vx"] + 0.05
    log = DriveLog(c | {"vy": vy}, np.zeros(len(vy), np.int64))
    record = make_record(log, load_car().vehicle, vy_displaced=True)
    fit = fit_names(Setting(record, "per_axle", PRIOR), (), None, exact=True)
    sensor = next(b for b in fit.predictor.blocks if b.effect.name == VY_SENSOR).parameters
    assert fit.parameters[sensor] == pytest.approx([0.6, 0.01, 0.05], rel=0.2, abs=0.02)
    unused = make_record(log, load_car().vehicle, ("vy", "yaw_rate"), vy_displaced=True)
    assert not unused.vy_displaced, "where it is no sensor of the fit it is what it is"


def test_without_an_accelerometer_neither_vy_nor_yaw_rate_is_explained_by_effects() -> None:
    assert set(examine(late(0.3, ay=False), load_car().vehicle).doubtful) == {"vy", "yaw_rate"}


@pytest.mark.long
def test_lateral_errors_are_simulated_where_no_lateral_sensor_can_be_compared() -> None:
    log = late(0.3, ay=False)
    health = examine(log, load_car().vehicle)
    record = make_record(health.log, load_car().vehicle, health.doubtful)
    result = identified_laterally(log, record, load_car().vehicle, PRIOR, "per_axle")
    assert result is not None
    errors = {"declared": 3.0, "refit": 3.0, "catalogue": 3.0, "with_effects": 3.0, "noise_floor": 0.1}
    names = ("ax", "ay", "yaw_acc", "vx_dot", "vy_dot")
    ahead = dict.fromkeys(("vx", "vy", "yaw_rate"), errors)
    summary = {"channels": dict.fromkeys(names, errors), "rollout": ahead, "long_rollout": ahead}
    told = with_simulated_lateral(summary, result)
    assert told["channels"]["ax"] == errors
    assert told["channels"]["ay"]["catalogue"] == result.rmse["ay"][1] < 0.5
    assert "simulated" in told["lateral"]
    found = lateral_prior(result, PRIOR)
    assert found["cx"] == PRIOR["cx"]
    stiffness = [np.prod([v[n] for n in ("br", "cr", "dr")]) for v in (found, TYRE)]
    assert stiffness[0] == pytest.approx(stiffness[1], rel=0.15)


def test_what_a_fit_finds_of_the_place_of_vy_and_the_lag_of_the_yaw_rate_is_taken_out_of_a_derived_ay() -> None:
    health = examine(late(0.3, ay=False), load_car().vehicle)
    before = health.log
    turning = derivative(before["t"], before["yaw_rate"], before.segment)
    moved = health.repaired(place_left(SimpleNamespace(values={f"{VY_SENSOR}.x": 1.5}, std={f"{VY_SENSOR}.x": 0.1})))
    assert np.allclose(moved.log["vy"], before["vy"] - 1.5 * before["yaw_rate"])
    assert np.allclose(moved.log["ay"], before["ay"] - 1.5 * turning)
    name = f"{YAW_RATE_TIMING}.tau"
    later = health.repaired(lag_left(SimpleNamespace(values={name: 0.04}, std={name: 0.01})))
    inner = slice(50, -50)
    assert np.allclose(
        later.log["yaw_rate"][inner], np.interp(later.log["t"] + 0.04, before["t"], before["yaw_rate"])[inner]
    )
    found = {finding.name: finding for finding in later.findings}["offset_yaw_rate"]
    assert found.size == pytest.approx(0.34, abs=0.05)
    assert f"{found.size:.3f} s" in found.description


@pytest.mark.long
def test_a_fit_is_kept_where_what_it_finds_of_vy_and_yaw_rate_is_taken_out(monkeypatch: pytest.MonkeyPatch) -> None:
    log, options = late(0.3, ay=False), Options()
    place, lag = f"{VY_SENSOR}.x", f"{YAW_RATE_TIMING}.tau"
    monkeypatch.setattr(fit_and_repair, "_is_fast", lambda *_: True)
    results = []
    for moves in (False, True):
        monkeypatch.setattr(fit_and_repair, "moves_ay", lambda *_, moves=moves: moves)
        results.append(identify(log, load_car().vehicle, PRIOR, options))
    left, taken_out = (one.fit.values for one in results)
    assert taken_out == left | {place: 0.0, lag: 0.0}, "a further fit drifts"
    before, after = ({f.name: f.size for f in one.health.findings} for one in results)
    assert after["offset_yaw_rate"] == pytest.approx(before["offset_yaw_rate"] + left[lag])
    assert after["position_vy"] == pytest.approx(before.get("position_vy", 0.0) + left[place])


@pytest.mark.parametrize(
    ("left", "converged", "fits", "best"),
    [([0.9, 0.05, 0.03, 0.02, 0.01], 9, 4, 3), ([0.9, 0.05, 0.03], 2, 3, 2), ([0.9, 0.03, 0.05], 9, 3, 1)],
)
def test_forces_are_fitted_again_while_that_tells_vy_and_yaw_rate_and_until_it_converges(
    monkeypatch: pytest.MonkeyPatch, left: list[float], converged: int, fits: int, best: int
) -> None:
    made: list[Any] = []

    def fit(*_: Any) -> Any:
        spread = {"vy": left[len(made)], "yaw_rate": 0.1}
        made.append(SimpleNamespace(fit=SimpleNamespace(values={}, spread=spread, converged=len(made) == converged)))
        return made[-1]

    monkeypatch.setattr(fit_and_repair, "_fit_and_split", fit)
    assert fit_and_repair._fit_with_forces(None, None, fit()) is made[best]
    assert len(made) == fits


def test_a_fit_that_simulates_neither_vy_nor_yaw_rate_is_not_gone_on_with(monkeypatch: pytest.MonkeyPatch) -> None:
    made = [SimpleNamespace(fit=SimpleNamespace(values={}, spread={"ay": ay}, converged=False)) for ay in (0.2, 0.1)]
    fits = iter(made)
    monkeypatch.setattr(fit_and_repair, "_fit_and_split", lambda *_: next(fits))
    assert fit_and_repair._fit_with_forces(None, None, made[0]) is made[0]


@pytest.mark.long
def test_a_diagnosis_goes_on_with_the_log_that_the_identification_repaired() -> None:
    result = identify(late(0.3, ay=False), load_car().vehicle, PRIOR, Options())
    banked_log = result.log.with_columns({"known_bank": np.full(len(result.log), 0.2)}, "a bank")
    log = repaired_log(replace(result, log=banked_log))
    assert "known_bank" not in log
    assert np.all(log["vy"] == result.log["vy"])
    assert np.std(log["ay"] - log["vx"] * log["yaw_rate"] - derivative(log["t"], log["vy"], log.segment)) < 1e-9


def test_a_log_with_lateral_sensors_is_compared_with_them(drives: dict[str, Any]) -> None:
    record = record_of(drives["flat"])
    log = DriveLog(drives["flat"].columns, np.zeros(len(drives["flat"].columns["t"]), np.int64))
    assert identified_laterally(log, record, load_car().vehicle, PRIOR, "per_axle") is None


@pytest.mark.slow
@pytest.mark.long
def test_measured_halves_do_not_contradict_each_other(measured_data: Path, tmp_path: Path) -> None:
    header, *rows = (measured_data / "av21" / "putnam_run4_2.csv").read_text().splitlines()
    middle = len(rows) // 2
    said = []
    for part in (rows, rows[:middle], rows[middle:]):
        path = tmp_path / "part.csv"
        path.write_text("\n".join([header, *part]) + "\n")
        said.append(json.loads(CliRunner().invoke(app, [str(path), "--json"]).stdout))
    whole, *halves = said
    assert whole["channels"]["ay"]["catalogue"] <= 0.115
    assert whole["channels"]["vx_dot"]["catalogue"] <= 0.374
    stated = [e for one in said for e in (*one["effects"], *one["not_told"])]
    drags = [e["parameters"]["k"] for e in stated if e["name"] == "aero_drag"]
    assert drags
    spread = max(d["value"] for d in drags) - min(d["value"] for d in drags)
    assert spread < 2.0 * max(d["std"] for d in drags)
    assert all(half["channels"]["ay"]["catalogue"] < 0.15 for half in halves)


def test_identification_of_a_log_too_short_for_laps_needs_no_road() -> None:
    columns = dict(simulate([TYRE], 30.0, seed=42)[0].columns)
    log = DriveLog(columns, np.zeros(len(columns["t"]), np.int64))
    assert identify(log, load_car().vehicle, TYRE, Options(method="batch")).rmse["ay"][1] < 0.2
