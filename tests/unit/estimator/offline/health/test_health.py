"""Log health: each defect is found with its size, and a clean log has none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drives.drive_simulator import TYRE, simulate
from support.drives.open_circle import circles

from estimator.drive_log.column_map import ColumnMap, ColumnSource
from estimator.drive_log.derived import smoothed
from estimator.drive_log.table import DriveLog, read_log, segment_numbers
from estimator.offline.health import Action, examine, units
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError

VEHICLE = load_car().vehicle
COLUMNS = simulate([TYRE], 60.0, seed=21)[0].columns


def _log(**changes: np.ndarray) -> DriveLog:
    columns = {**COLUMNS, **changes}
    return DriveLog(
        columns=columns,
        segment=segment_numbers(columns["t"]),
        extra=tuple(n for n in changes if n not in COLUMNS),
    )


def _late(name: str, seconds: float) -> np.ndarray:
    return _later(COLUMNS[name], seconds)


def _later(values: np.ndarray, seconds: float) -> np.ndarray:
    return np.asarray(np.interp(COLUMNS["t"] - seconds, COLUMNS["t"], values))


def _only(log: DriveLog, name: str, **options: object) -> object:
    found = {f.name: f for f in examine(log, VEHICLE, **options).findings}  # type: ignore[arg-type]
    assert name in found, f"found {sorted(found)}"
    return found[name]


def test_a_clean_log_has_no_findings() -> None:
    assert examine(_log(), VEHICLE).findings == ()


@pytest.mark.parametrize("lag", [0.15, 0.32, -0.2])
def test_late_yaw_rate_is_found_and_re_aligned(lag: float) -> None:
    log = _log(yaw_rate=_late("yaw_rate", lag))
    finding = _only(log, "offset_yaw_rate")
    assert finding.size == pytest.approx(lag, abs=0.02)  # type: ignore[attr-defined]
    repaired = examine(log, VEHICLE).log
    inner = slice(200, -200)
    rows = np.searchsorted(COLUMNS["t"], repaired["t"][inner])
    assert np.std(repaired["yaw_rate"][inner] - COLUMNS["yaw_rate"][rows]) < 0.01


def _path() -> dict[str, np.ndarray]:
    step = float(np.median(np.diff(COLUMNS["t"])))
    course = np.cumsum(COLUMNS["yaw_rate"]) * step
    velocity = (COLUMNS["vx"] + 1j * COLUMNS["vy"]) * np.exp(1j * course)
    place = np.cumsum(velocity) * step
    return {"x": place.real, "y": place.imag}


@pytest.mark.parametrize("lag", [0.06, 0.12, -0.1])
def test_a_late_speed_is_found_and_re_aligned(lag: float) -> None:
    log = _log(vx=_late("vx", lag), **_path())
    finding = _only(log, "offset_vx")
    assert finding.size == pytest.approx(lag, abs=0.015)  # type: ignore[attr-defined]
    repaired = examine(log, VEHICLE).log
    rows = np.searchsorted(COLUMNS["t"], repaired["t"][200:-200])
    off = np.std(repaired["vx"][200:-200] - COLUMNS["vx"][rows])
    assert off < 0.5 * np.std(log["vx"][rows] - COLUMNS["vx"][rows])


def test_a_speed_that_only_one_witness_contradicts_stays_as_it_is() -> None:
    late = {name: _later(values, 0.12) for name, values in _path().items()}
    assert "offset_vx" not in {f.name for f in examine(_log(**late), VEHICLE).findings}
    assert "offset_vx" not in {f.name for f in examine(_log(ax=_late("ax", 0.12), **_path()), VEHICLE).findings}


def test_a_repair_can_be_switched_off() -> None:
    log = _log(yaw_rate=_late("yaw_rate", 0.3))
    report = examine(log, VEHICLE, keep={"offset_yaw_rate"})
    assert next(f for f in report.findings if f.name == "offset_yaw_rate").action is Action.LEFT
    assert np.array_equal(report.log["yaw_rate"], log["yaw_rate"])


def test_misaligned_sensor_of_vy_is_found_and_corrected() -> None:
    log = _log(vy=COLUMNS["vy"] + 0.015 * COLUMNS["vx"] - 0.1)
    finding = _only(log, "offset_vy")
    expected = 0.015 - 0.1 / np.median(COLUMNS["vx"])
    assert finding.size == pytest.approx(expected, abs=0.003)  # type: ignore[attr-defined]
    assert np.std(examine(log, VEHICLE).log["vy"] - COLUMNS["vy"]) < 0.06


def test_vy_measured_ahead_of_the_centre_of_gravity_is_found() -> None:
    finding = _only(_log(vy=COLUMNS["vy"] + 1.2 * COLUMNS["yaw_rate"]), "position_vy")
    assert finding.size == pytest.approx(1.2, abs=0.25)  # type: ignore[attr-defined]


@pytest.mark.parametrize("ahead", [1.5, -1.5])
def test_where_vy_is_measured_is_told_by_a_measured_ay_or_said_to_be_unknown(measured_data: Path, ahead: float) -> None:
    """A lap with downforce, whose tyres alone place vy 1.7 m off."""
    log = read_log(measured_data / "public/d00_ok.csv")
    moved = replace(log, columns={**log.columns, "vy": log["vy"] + ahead * log["yaw_rate"]})
    healthy, found = (examine(one, VEHICLE) for one in (log, moved))
    assert found.vy_was_placed and not healthy.vy_is_displaced
    assert np.std(found.log["vy"] - log["vy"]) < 0.3 * np.std(moved["vy"] - log["vy"])
    without = examine(replace(moved, derived={"ay": "from velocities"}), VEHICLE)
    assert without.vy_may_be_off > 1.0 > healthy.vy_may_be_off
    assert not {"unit_vy", "position_vy"} & {f.name for f in without.findings}, "knots are no better than a place"


def test_an_accelerometer_off_the_centre_of_gravity_moves_no_vy() -> None:
    turning = np.gradient(COLUMNS["yaw_rate"], COLUMNS["t"])
    report = examine(_log(ay=COLUMNS["ay"] + 0.8 * smoothed(COLUMNS["t"], turning, np.zeros(len(turning)))), VEHICLE)
    assert not report.vy_is_displaced
    assert next(f for f in report.findings if f.name == "position_ay").size == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize("offset", [0.006, -0.012])
def test_steering_that_does_not_read_zero_is_found(offset: float) -> None:
    report = examine(_log(steer=COLUMNS["steer"] + offset), VEHICLE)
    assert report.steering_is_off
    finding = next(f for f in report.findings if f.name == "offset_steer")
    assert finding.size == pytest.approx(offset, abs=0.001)
    assert np.array_equal(report.log["steer"], COLUMNS["steer"] + offset), "the fit allows for it, the log keeps it"


def test_a_constant_circle_tells_no_steering_zero() -> None:
    rng, n = np.random.default_rng(5), 6000
    t, vx = 0.01 * np.arange(n), np.linspace(1.0, 2.5, n)
    wave = 0.02 * np.sin(0.7 * t)
    columns = {"t": t, "vx": vx + wave, "vy": 0.02 * vx, "yaw_rate": vx / 0.6 * (1 - 0.05 * vx) + wave,
               "steer": np.full(n, 0.3) + 1e-4 * wave, "drive": wave}  # fmt: skip
    columns |= {"ax": np.gradient(vx, t), "ay": columns["vx"] * columns["yaw_rate"]}
    noisy = {name: c + 0.003 * rng.normal(size=n) * (name not in ("t", "steer")) for name, c in columns.items()}
    found = {f.name: f for f in examine(DriveLog(noisy, np.zeros(n, np.int64)), load_car().vehicle).findings}
    assert "offset_steer" not in found
    assert "cannot be told" in found["unknown_zero_steer"].description


def test_on_one_circle_nothing_is_said_of_vy_and_an_acceleration_in_noise_is_kept() -> None:
    assert not {"offset_vy", "position_vy", "useless_ax"} & {f.name for f in examine(circles(), VEHICLE).findings}


def test_an_acceleration_that_changes_more_slowly_than_a_lag_can_be_told_from_is_kept() -> None:
    """3 m/s up and down within 60 s: what is quicker in the accelerometer is noise."""
    t, rng = np.arange(0.0, 240.0, 0.02), np.random.default_rng(4)
    rate, about = 0.3 * np.sin(0.8 * t), 2.0 * np.pi / 60.0
    vx = 30.0 + 3.0 * np.sin(about * t)
    columns = {
        "t": t, "vx": vx + 0.02 * rng.standard_normal(len(t)), "vy": 0.02 * rng.standard_normal(len(t)),
        "yaw_rate": rate, "ax": 3.0 * about * np.cos(about * t) + 0.1 * rng.standard_normal(len(t)),
        "ay": vx * rate + 0.1 * rng.standard_normal(len(t)), "steer": 2.97 * rate / vx + 0.002 * vx * rate,
        "drive": 0.01 * np.cos(about * t),
    }  # fmt: skip
    log = DriveLog(columns, np.zeros(len(t), np.int64))
    assert "useless_ax" not in {finding.name for finding in examine(log, VEHICLE).findings}


def test_late_and_attenuated_acceleration_is_found_useless() -> None:
    useless = 0.4 * _late("ax", 1.2)
    finding = _only(_log(ax_logged=useless), "useless_ax_logged")
    assert finding.size == pytest.approx(1.2, abs=0.1)  # type: ignore[attr-defined]
    report = examine(_log(ax=useless), VEHICLE)
    assert "ax" in report.log.derived
    assert np.corrcoef(report.log["ax"], COLUMNS["ax"])[0, 1] > 0.95


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("yaw_rate", 57.29578, "degrees"),
        ("steer", 57.29578, "degrees"),
        ("steer", -1.0, "opposite sign"),
        ("ay", -1.0, "opposite sign"),
        ("ax", -1.0, "opposite sign"),
        ("drive", -1.0, "opposite sign"),
        ("drive", 100.0, "percent"),
    ],
)
def test_unit_and_sign_slips_are_found_and_converted(name: str, factor: float, words: str) -> None:
    report = examine(_log(**{name: factor * COLUMNS[name]}), VEHICLE)
    finding = next(f for f in report.findings if f.name == f"unit_{name}")
    assert words in finding.description
    assert np.allclose(report.log[name], COLUMNS[name], rtol=1e-4)


@pytest.mark.parametrize("hand", [1.0, -1.0])
def test_positions_that_turn_against_the_motion_are_told_and_left(hand: float) -> None:
    step = np.gradient(COLUMNS["t"])
    to_map = np.exp(1j * np.cumsum(step * COLUMNS["yaw_rate"])) * (COLUMNS["vx"] + 1j * COLUMNS["vy"])
    place = np.cumsum(step * to_map)
    report = examine(_log(x=place.real, y=hand * place.imag), VEHICLE)
    assert ("mirrored_y" in {f.name for f in report.findings}) == (hand < 0)
    assert np.array_equal(report.log["y"], hand * place.imag)


def test_a_compass_heading_in_degrees_becomes_the_yaw_of_the_map() -> None:
    track = np.cumsum(0.01 * np.exp(1j * COLUMNS["yaw"]) * (COLUMNS["vx"] + 1j * COLUMNS["vy"]))
    compass = (90.0 - np.degrees(COLUMNS["yaw"])) % 360.0
    report = examine(_log(x=track.real, y=track.imag, yaw=compass), VEHICLE)
    assert np.abs(np.exp(1j * report.log["yaw"]) - np.exp(1j * COLUMNS["yaw"])).max() < 1e-6
    assert {"unit_yaw", "axis_yaw"} <= {f.name for f in report.findings}


def test_a_speed_held_over_rows_is_said() -> None:
    held = COLUMNS["vx"][np.arange(len(COLUMNS["vx"])) // 10 * 10]
    assert "90 % of the rows" in _only(_log(vx=held), "held_vx").description  # type: ignore[attr-defined]


def test_wheel_speeds_in_kmh_and_throttle_in_percent_are_found() -> None:
    log = _log(wheel_speed_fl=3.6 * COLUMNS["vx"], throttle=50.0 + 50.0 * np.sin(COLUMNS["t"]))
    names = {f.name for f in examine(log, VEHICLE).findings}
    assert {"unit_wheel_speed_fl", "unit_throttle"} <= names


def test_quantised_channel_and_irregular_steps_are_reported_and_left() -> None:
    t = COLUMNS["t"].copy()
    t[::25] += 0.004
    report = examine(_log(t=t, vy=np.round(COLUMNS["vy"] / 0.2) * 0.2), VEHICLE)
    found = {f.name: f for f in report.findings}
    assert found["quantised_vy"].size == pytest.approx(0.2, rel=0.01)
    assert found["irregular_steps"].action is Action.LEFT


def test_wrong_rolling_radius_is_reported() -> None:
    wheels = {f"wheel_speed_{w}": 1.015 * COLUMNS["vx"] for w in ("rl", "rr")}
    finding = _only(_log(**wheels), "scale_rear_wheels")
    assert finding.size == pytest.approx(0.015, abs=0.001)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("name", "factor"), [("vy", 1e9), ("yaw_rate", 1e9), ("steer", 9.3)])
def test_a_channel_of_no_known_unit_is_asked_for_and_used_where_its_user_says_so(name: str, factor: float) -> None:
    log = _log(**{name: factor * COLUMNS[name]})
    with pytest.raises(InputError, match="--columns"):
        examine(log, VEHICLE)
    keep = [f"{kind}_{channel}" for kind in ("unknown_unit", "beyond") for channel in COLUMNS]
    assert not [f for f in examine(log, VEHICLE, keep).findings if f.action is Action.REFUSED]


def test_a_channel_too_small_to_be_squared_is_examined_all_the_same() -> None:
    examine(_log(steer=1e-300 * COLUMNS["steer"]), VEHICLE)


KMH, KNOT, DEG, G = 3.6, 3600.0 / 1852.0, 57.29578, 9.80665
SLIPS: list[dict[str, float]] = [
    {}, {"vx": KMH}, {"vx": KMH, "vy": KMH}, {"vx": 2.23694, "vy": 2.23694}, {"vx": KNOT, "vy": KNOT}, {"vy": -1.0},
    {"yaw_rate": -DEG},    {"ax": 1 / G, "ay": 1 / G}, {"steer": -DEG}, {"yaw_rate": DEG, "steer": DEG},
    {"vx": KMH, "vy": KMH, "yaw_rate": DEG, "ax": 1 / G, "ay": 1 / G, "steer": DEG},
]  # fmt: skip


@pytest.mark.parametrize("slips", SLIPS, ids=lambda slips: " ".join(f"{n}*{k:.3g}" for n, k in slips.items()) or "none")
def test_units_and_signs_of_all_channels_are_found_together_without_positions(slips: dict[str, float]) -> None:
    log = _log(**{name: factor * COLUMNS[name] for name, factor in slips.items()})
    columns = {n: c for n, c in log.columns.items() if n not in ("x", "y", "yaw")}
    found = {f.channel: f.size for f in units.find(replace(log, columns=columns), VEHICLE)}
    assert found == {name: pytest.approx(factor, rel=1e-3) for name, factor in slips.items()}


@pytest.mark.parametrize(
    ("name", "channel", "factor"), [("d04c_kmh_nogps", "vx", KMH), ("d27a_yawrate_deg", "yaw_rate", DEG)]
)
def test_units_of_logs_without_positions_or_heading_are_converted(
    measured_data: Path, name: str, channel: str, factor: float
) -> None:
    log = read_log(measured_data / "public" / f"{name}.csv")
    found = {f.channel: f.size for f in examine(log, VEHICLE).findings if f.action is Action.CONVERTED}
    assert found == {channel: pytest.approx(factor, rel=1e-3)}


def test_a_steering_wheel_of_unknown_ratio_is_asked_for_and_converted_as_declared(measured_data: Path) -> None:
    file = measured_data / "public" / "d06b_handwheel_deg.csv"
    with pytest.raises(InputError, match="give its unit and ratio with --columns"):
        examine(read_log(file), VEHICLE)
    declared = {name: ColumnSource.model_validate({"from": name}) for name in read_log(file).columns if name != "steer"}
    steering = ColumnSource.model_validate({"from": "steer", "unit": "deg", "ratio": 9.3})
    log = read_log(file, ColumnMap({**declared, "steer": steering}, declared=True))
    truth = read_log(measured_data / "public" / "d00_ok.csv")
    assert np.allclose(log["steer"], truth["steer"], atol=1e-4)
    assert not [f for f in examine(log, VEHICLE).findings if f.action is Action.CONVERTED]
