"""What a recorded session tells beyond its velocities: axle loads, the place of a sensor, a vy that is not measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import PRIOR, record_of

from estimator.drive_log.smoothing import wiener
from estimator.drive_log.table import DriveLog
from estimator.model.declared_vehicle import all_candidates
from estimator.model.parameters import Layout
from estimator.offline.predict.lateral_velocity import with_predicted_vy
from estimator.offline.record.map_road import record_on_map
from estimator.offline.record.record import Record, make_record
from estimator.offline.search.greedy import Greedy
from estimator.offline.search.sensor_place import accelerometer_ahead, gyro_gain, speed_scale
from estimator.offline.search.trial import Setting, fit_names
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track

LAYOUT: Layout = "per_axle"


def log_of(drive: Any, **changed: np.ndarray) -> DriveLog:
    columns = {**drive.columns, **changed}
    return DriveLog(columns, np.zeros(len(columns["t"]), np.int64))


def some(record: Record, every: int) -> Record:
    """Part of the windows, held out in eight stretches."""
    part = record.select(np.arange(record.windows) % every == 0)
    return replace(part, lap=np.arange(part.windows) * 8 // part.windows)


def test_a_vertical_accelerometer_tells_the_axle_loads_and_leaves_no_bank_to_guess_them_by(
    drives: dict[str, Any],
) -> None:
    t = drives["flat"].columns["t"]
    pressed = 0.3 * np.sin(2 * np.pi * t / 8.0)
    az = GRAVITY * (1.0 + pressed) + np.random.default_rng(3).normal(0.0, 0.11, len(t))
    record = make_record(log_of(drives["flat"], az=az), load_car().vehicle)
    assert float(np.std((record.signals["extra_load"] - pressed)[record.rows])) < 0.005
    told, guessed = (Setting(r, LAYOUT, PRIOR).model(["road_bank"]) for r in (record, record_of(drives["flat"])))
    assert "road_bank_load" not in {effect.name for effect in told.effects}
    assert "road_bank_load" in {effect.name for effect in guessed.effects}


def test_an_accelerometer_without_gravity_says_nothing_of_the_loads(drives: dict[str, Any]) -> None:
    record = make_record(log_of(drives["flat"], az=np.zeros(len(drives["flat"].columns["t"]))), load_car().vehicle)
    assert not record.signals["extra_load"].any()


def test_a_drifting_vy_is_replaced_by_what_yaw_rate_and_speed_say(drives: dict[str, Any]) -> None:
    columns = drives["none"].columns
    wrong = columns["vy"] + 0.12 * np.sin(2 * np.pi * columns["t"] / 5.0)
    record = make_record(replace(log_of(drives["none"], vy=wrong), derived={"vy": "drifts"}), load_car().vehicle)
    done = fit_names(Setting(some(record, 4), LAYOUT, PRIOR), (), None)
    run = np.sort(record.rows[:12].ravel())
    parts = np.split(run, np.flatnonzero(np.diff(run) != 1) + 1)
    better = with_predicted_vy(record, parts, done.predictor.model, done.parameters, done.noise)
    rows = np.concatenate([part[100:] for part in parts])
    true = wiener(columns["vy"], record.step).value
    before, after = (float(np.std((r.signals["vy"] - true)[rows])) for r in (record, better))
    assert before > 0.07
    assert after < 0.2 * before


@pytest.mark.parametrize("ahead", [0.0, -0.6])
def test_kinematics_tell_where_the_accelerometer_lies_whatever_the_tyres_do(
    drives: dict[str, Any], ahead: float
) -> None:
    columns = drives["much"].columns
    turned = ahead * wiener(columns["yaw_rate"], 0.01).rate
    found = accelerometer_ahead(make_record(log_of(drives["much"], ay=columns["ay"] + turned), load_car().vehicle))
    assert found is not None
    assert found[0] == pytest.approx(ahead, abs=0.15), "half a sample at 30 m/s is 0.15 m"
    assert found[1] < 0.05


@pytest.mark.parametrize("scale", [1.0, 0.96])
def test_positions_that_are_held_and_jump_tell_how_the_speed_is_scaled(drives: dict[str, Any], scale: float) -> None:
    columns = drives["single"].columns
    held = np.arange(len(columns["t"])) // 10 * 10
    x = columns["x"][held]
    x[::1500] += 8.0
    log = log_of(drives["single"], vx=scale * columns["vx"], x=x, y=columns["y"][held])
    found = speed_scale(make_record(log, load_car().vehicle))
    assert found is not None
    assert found[0] == pytest.approx(scale, abs=0.004)
    assert found[1] < 0.003
    without = {n: c for n, c in log.columns.items() if n != "x"}
    assert speed_scale(make_record(replace(log, columns=without), load_car().vehicle)) is None


@pytest.mark.parametrize("gain", [1.0, 0.97])
def test_the_heading_tells_the_gain_of_a_gyroscope_whatever_its_zero(drives: dict[str, Any], gain: float) -> None:
    rate = gain * drives["single"].columns["yaw_rate"] + 0.004
    found = gyro_gain(make_record(log_of(drives["single"], yaw_rate=rate), load_car().vehicle))
    assert found is not None
    assert abs(found[0] - gain) < min(4.0 * found[1], 0.002)
    without = {n: c for n, c in log_of(drives["single"]).columns.items() if n != "yaw"}
    assert gyro_gain(make_record(replace(log_of(drives["single"]), columns=without), load_car().vehicle)) is None


def test_at_one_speed_rolling_resistance_is_not_told_from_drag(drives: dict[str, Any]) -> None:
    others = frozenset(all_candidates()) - {"rolling_resistance", "aero_drag"}
    columns, rng = drives["single"].columns, np.random.default_rng(11)
    noisy = {n: columns[n] + rng.normal(0.0, s, len(columns["t"])) for n, s in (("ax", 3.0), ("vx", 0.6))}
    whole = make_record(log_of(drives["single"], **noisy), load_car().vehicle)
    speed = whole.state_means[0].mean(axis=1)
    narrow = whole.select(np.abs(speed - np.median(speed)) < 0.6)
    for record, told in ((some(whole, 8), True), (some(narrow, 1), False)):
        setting = Setting(record, LAYOUT, PRIOR, untried=others)
        start = fit_names(setting, (), None)
        fit = fit_names(setting, ["rolling_resistance"], start)
        state = Greedy(setting, lambda _: None, lambda _a, _b: False, start, ["rolling_resistance"], fit, [])
        state.recheck()
        assert state.names == ["rolling_resistance"]
        assert state.look_alikes() == ({} if told else {"rolling_resistance": "aero_drag"})


def test_a_map_of_another_track_is_refused_in_one_line(drives: dict[str, Any]) -> None:
    columns = drives["flat"].columns
    away = log_of(drives["flat"], x=columns["x"] + 5000.0)
    with pytest.raises(InputError, match=r"--track road_course: half of the log is more than \d+ m off"):
        record_on_map(record_of(drives["flat"]), away, load_track("road_course"), "road_course")
    without = replace(away, columns={n: c for n, c in columns.items() if n != "x"})
    with pytest.raises(InputError, match="no columns x and y"):
        record_on_map(record_of(drives["flat"]), without, load_track("road_course"), "road_course")
