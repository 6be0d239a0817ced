"""Drive logs: what is read, what is derived, and what is refused with file, row and column."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from support.drives.drive_simulator import TYRE, simulate, to_csv

from estimator.drive_log.derived import smoothed
from estimator.drive_log.smoothing import PAD, wiener
from estimator.drive_log.table import DriveLog, read_log, read_logs
from hil_gateway.process.errors import InputError

DRIVE = simulate([TYRE], 8.0, seed=3)[0].columns


def _write(tmp_path: Path, changes: dict[str, object] | None = None, without: tuple[str, ...] = ()) -> Path:
    columns = {n: c.copy() for n, c in DRIVE.items() if n not in without}
    columns |= changes or {}  # type: ignore[arg-type]
    path = tmp_path / "drive.csv"
    path.write_text(to_csv(columns))
    return path


def _refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_log(path)
    for word in (path.name, *words):
        assert word in str(caught.value)


def test_smoothing_takes_half_of_the_noise_and_nothing_of_a_parabola() -> None:
    t = 0.04 * np.arange(500)
    noise = np.random.default_rng(0).normal(0.0, 0.002, 500)
    one = np.zeros(500, np.int64)
    assert np.allclose(smoothed(t, 0.01 * t**2, one), 0.01 * t**2)
    assert np.std(smoothed(t, noise, one)) < 0.6 * np.std(noise)


def test_columns_come_back_as_written(tmp_path: Path) -> None:
    log = read_log(_write(tmp_path, {"tyre_temperature": 80.0 + DRIVE["t"]}))
    assert np.allclose(log["ay"], DRIVE["ay"], rtol=1e-8)
    assert log.extra == ("tyre_temperature",)
    assert log.derived == {}
    assert log.step == pytest.approx(0.01)


def test_missing_column_is_named(tmp_path: Path) -> None:
    _refused(_write(tmp_path, without=("vy",)), "row 1", "vy", "missing")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_non_finite_value_is_named_by_row_and_column(tmp_path: Path, value: float) -> None:
    ay = DRIVE["ay"].copy()
    ay[99] = value
    _refused(_write(tmp_path, {"ay": ay}), "row 101", "ay", "not finite")


def test_text_in_a_cell_is_named_by_row_and_column(tmp_path: Path) -> None:
    path = _write(tmp_path)
    lines = path.read_text().splitlines()
    cells = lines[41].split(",")
    cells[2] = "abc"
    path.write_text("\n".join([*lines[:41], ",".join(cells), *lines[42:]]) + "\n")
    _refused(path, "row 42", "vy", "'abc'")


def test_row_with_too_few_values_is_named(tmp_path: Path) -> None:
    path = _write(tmp_path)
    lines = path.read_text().splitlines()
    lines[10] = lines[10].rsplit(",", 2)[0]
    path.write_text("\n".join(lines) + "\n")
    _refused(path, "row 11")


def test_time_running_backwards_is_named(tmp_path: Path) -> None:
    t = DRIVE["t"].copy()
    t[300] = t[298]
    _refused(_write(tmp_path, {"t": t}), "row 302", "column t", "does not increase")


@pytest.mark.parametrize("name", ["vy", "yaw_rate", "ay", "ax", "vx", "yaw"])
def test_sensor_frozen_while_the_car_moves_is_named(tmp_path: Path, name: str) -> None:
    values = DRIVE[name].copy()
    values[200:600] = values[200]
    _refused(_write(tmp_path, {name: values}), "rows 202 to 601", name, "frozen")


def test_steering_frozen_for_the_whole_log_is_refused(tmp_path: Path) -> None:
    _refused(_write(tmp_path, {"steer": np.zeros_like(DRIVE["t"])}), "steer", "frozen")


def test_too_short_a_log_is_refused(tmp_path: Path) -> None:
    _refused(_write(tmp_path, {n: c[:50] for n, c in DRIVE.items()}), "50 rows", "200")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us")])
def test_times_in_another_unit_are_told_by_the_rate_and_that_is_said(tmp_path: Path, factor: float, unit: str) -> None:
    log = read_log(_write(tmp_path, {"t": factor * DRIVE["t"]}))
    assert log.step == pytest.approx(0.01)
    assert any(f"t is in {unit}" in note for note in log.notes)


def test_a_rate_that_is_none_in_any_unit_is_refused(tmp_path: Path) -> None:
    _refused(_write(tmp_path, {"t": 20.0 * DRIVE["t"]}), "column t", "seconds")


@pytest.mark.parametrize("factor", [-1.0, 1e-300])
def test_a_speed_that_is_never_forward_is_refused(tmp_path: Path, factor: float) -> None:
    _refused(_write(tmp_path, {"vx": factor * DRIVE["vx"]}), "column vx", "positive forward")


def test_repeated_and_cut_rows_are_left_out_counted_and_named(tmp_path: Path) -> None:
    path = _write(tmp_path)
    lines = path.read_text().splitlines()
    lines.insert(20, lines[19])
    path.write_text("\n".join(lines) + "\n1.0,2")
    log = read_log(path)
    assert len(log) == len(DRIVE["t"])
    assert any("1 rows written twice" in note and "row 21" in note for note in log.notes)
    assert any("cut off" in note for note in log.notes)


def test_missing_accelerations_are_derived_and_said_so(tmp_path: Path) -> None:
    log = read_log(_write(tmp_path, without=("ax", "ay")))
    assert set(log.derived) == {"ax", "ay"}
    inner = slice(50, -50)
    assert np.sqrt(np.mean((log["ay"] - DRIVE["ay"])[inner] ** 2)) < 0.25
    assert sum("is derived" in note for note in log.notes) == 2


def test_drive_is_derived_from_wheel_speeds_whatever_their_rolling_radius(tmp_path: Path) -> None:
    rear = 1.03 * DRIVE["vx"] * (1.0 + DRIVE["drive"])
    log = read_log(_write(tmp_path, {"wheel_speed_rl": rear, "wheel_speed_rr": rear}, without=("drive",)))
    assert "wheel speeds" in log.derived["drive"]
    assert np.corrcoef(log["drive"], DRIVE["drive"])[0, 1] > 0.99


def test_drive_without_any_source_is_refused(tmp_path: Path) -> None:
    _refused(_write(tmp_path, without=("drive",)), "drive", "throttle")


def test_gaps_start_new_segments(tmp_path: Path) -> None:
    t = DRIVE["t"].copy()
    t[400:] += 5.0
    log = read_log(_write(tmp_path, {"t": t}))
    assert [s.stop - s.start for s in log.segments()] == [400, 400]


def test_several_files_are_one_data_set_with_gaps(tmp_path: Path) -> None:
    first = _write(tmp_path, {"lap": np.zeros(800)})
    second = first.rename(tmp_path / "second.csv")
    first = _write(tmp_path, {"lap": np.zeros(800)}, without=("yaw",))
    log = read_logs([first, second])
    assert len(log) == 1600
    assert len(log.segments()) == 2
    assert np.all(np.diff(log["t"]) > 0)
    assert [lap for lap, _ in log.laps()] == [0, 1000]
    assert "yaw" not in log
    assert any("yaw" in note for note in log.notes)


def test_a_hundred_thousand_rows_are_read_in_about_a_second(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    n = 97_000
    columns = {name: rng.standard_normal(n).round(5) for name in ("vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive")}
    path = tmp_path / "long.csv"
    path.write_text(to_csv({"t": np.arange(n) / 100, **columns}))
    began = time.process_time()
    log = read_log(path)
    assert isinstance(log, DriveLog)
    assert time.process_time() - began < 2.0


def _mean_off_its_trend(values: np.ndarray) -> float:
    """What the spectrum of a padded signal has at frequency 0."""
    ends = 2 * values[0] - values[PAD:0:-1], 2 * values[-1] - values[-2 : -PAD - 2 : -1]
    padded = np.concatenate([ends[0], values, ends[1]])
    return float(padded.mean() - 0.5 * (padded[0] + padded[-1]))


def test_a_mean_that_happens_to_be_small_does_not_take_the_rest_of_a_signal_for_noise() -> None:
    t = np.linspace(0.0, 1.0, 20_000)
    wave, arch = np.sin(6.0 * np.pi * t) + 0.3 * t, t * (1.0 - t)
    measured = wave + np.random.default_rng(2).normal(0.0, 0.02, len(t))
    share = -_mean_off_its_trend(measured) / _mean_off_its_trend(arch)
    value = wiener(measured + share * arch, 0.01).value
    assert np.sqrt(np.mean((value - wave - share * arch) ** 2)) < 0.005


def test_a_motion_beyond_a_gap_in_the_spectrum_is_not_taken_for_noise_and_noise_not_for_motion() -> None:
    t = np.arange(0.0, 600.0, 0.04)
    slow, steering = 0.4 * np.sin(0.3 * t), 0.03 * np.sin(2.0 * np.pi * 0.9 * t + 0.2 * np.sin(0.05 * t))
    noise = np.random.default_rng(3).normal(0.0, 0.02, len(t))
    inner = slice(100, -100)
    kept = wiener(slow + steering + noise, 0.04).value - slow - steering
    assert np.std(kept[inner]) < 0.25 * np.std(steering)
    quiet = wiener(slow + noise, 0.04)
    assert np.std((quiet.value - slow)[inner]) < 0.15 * 0.02
    assert quiet.bandwidth < 0.3
