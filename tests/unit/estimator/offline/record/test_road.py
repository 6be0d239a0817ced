"""The road from kinematics: there whatever tyres and sensors do, and nothing where the road is flat."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.drives.open_circle import circles
from support.drives.practice_drives import record_of

from estimator.drive_log.table import DriveLog, read_logs
from estimator.model.parameters import Quantity
from estimator.offline.health import examine
from estimator.offline.record.declared import read_vehicle
from estimator.offline.record.record import Record, make_record
from estimator.offline.record.road import find_road, share_in_kinematics
from hil_gateway.car.car import load_car
from hil_gateway.process.arrays import Array


def profile(record: Record, name: str) -> Array:
    basis = record.bases["track_position"]
    return basis.matrix(np.linspace(0.0, record.lap_length, 400)) @ find_road(record)[name].coefficients


def test_bank_and_grade_are_found_to_a_third_of_a_degree(drives: dict[str, Any]) -> None:
    record = record_of(drives["hilly"])
    # bank and grade are sums of two waves over the lap; their mean cannot be told from an offset of the sensor
    for name, waves in (("road_bank", (0.6, 0.4)), ("road_grade", (0.7, 0.3))):
        size = drives["hilly"].effects[name]
        found = profile(record, name)
        assert np.std(found) == pytest.approx(size * np.hypot(*waves) / np.sqrt(2), abs=0.003)
        assert np.ptp(found) <= 2 * size + 0.01


@pytest.mark.parametrize("name", ["hilly", "flat"])
def test_two_laps_tell_a_road_and_one_does_not(drives: dict[str, Any], name: str) -> None:
    record = record_of(drives[name])
    two = record.select(np.isin(record.lap, np.unique(record.lap)[1:3]))
    assert set(find_road(two)) == ({"road_bank", "road_grade"} if name == "hilly" else set())
    assert find_road(record.select(record.lap == record.lap[0])) == {}


def test_a_flat_road_is_no_road(drives: dict[str, Any]) -> None:
    assert find_road(record_of(drives["flat"])) == {}


def test_without_a_sensor_of_ax_a_grade_is_told_from_forces_that_the_driver_repeats(drives: dict[str, Any]) -> None:
    hilly, flat = (record_of(drives[name]) for name in ("hilly", "flat"))
    slope = find_road(hilly)["road_grade"].coefficients
    unseen = [replace(one, used=one.used & (np.arange(5) > 0)) for one in (hilly, flat)]
    assert share_in_kinematics(unseen[0], Quantity.GRADE, slope) == pytest.approx(1.0, abs=0.1)
    assert abs(share_in_kinematics(unseen[1], Quantity.GRADE, slope) or 1.0) < 0.1
    assert share_in_kinematics(unseen[0], Quantity.BANK, slope) is not None, "the sensor of ay is there"


def test_an_open_circle_tells_no_bank() -> None:
    """It has no straights: a bank would be the zero of the accelerometer."""
    columns = dict(circles().columns)
    angle = 0.02 * np.cumsum(columns["vx"]) / 70.0
    columns |= {"x": 70.0 * np.sin(angle), "y": -70.0 * np.cos(angle), "lap": angle // (2 * np.pi)}
    columns["ay"] = columns["ay"] - 0.5
    log = DriveLog(columns, np.zeros(len(angle), np.int64))
    assert "road_bank" not in find_road(make_record(log, load_car().vehicle))


def test_errors_of_the_sensors_are_not_taken_for_a_road(drives: dict[str, Any]) -> None:
    drive = drives["flat"]
    c = drive.columns
    changed = c | {"ay": 1.02 * c["ay"] + 0.2 + 0.02 * c["ax"], "ax": c["ax"] - 0.15 - 0.02 * c["ay"]}
    assert find_road(record_of(replace(drive, columns=changed))) == {}


def test_a_road_is_found_beside_errors_of_the_sensors(drives: dict[str, Any]) -> None:
    drive = drives["hilly"]
    c = drive.columns
    changed = c | {"ay": 1.02 * c["ay"] + 0.1, "ax": c["ax"] - 0.1}
    true, found = (profile(record_of(replace(drive, columns=each)), "road_bank") for each in (c, changed))
    # offset and mean bank are one: the shape is what the road adds
    assert np.std(found - true) < 0.004


def test_without_an_accelerometer_nothing_is_said_of_the_road(drives: dict[str, Any]) -> None:
    record = record_of(drives["hilly"])
    assert find_road(replace(record, used=record.used & ~np.array([True, True, False, False, False]))) == {}


def test_a_banked_oval_is_no_displaced_sensor_and_its_bank_is_found(measured_data: Path) -> None:
    car = read_vehicle(measured_data / "plant" / "vehicle.json", load_car())
    health = examine(read_logs([measured_data / "plant" / "double_track_oval.csv"]), car)
    assert not health.vy_is_displaced
    record = make_record(health.log, car, health.doubtful)
    bank = np.degrees(profile(record, "road_bank"))
    turning = np.quantile(bank, 0.25)
    assert turning == pytest.approx(-9.2, abs=0.7)
    assert np.quantile(bank, 0.6) == pytest.approx(0.0, abs=0.7)
