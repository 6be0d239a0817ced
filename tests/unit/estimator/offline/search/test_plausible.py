"""What a fit may be believed: sizes a car can have, beyond the log's sampling and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import PRIOR, record_of

from estimator.model.parameters import Quantity
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.health.finding import LEAST_ERRORS
from estimator.offline.record.record import Record
from estimator.offline.record.road import LEAST_ANGLE, share_in_kinematics
from estimator.offline.result.uncertainty import insignificant
from estimator.offline.search.plausible import believed, there
from estimator.offline.search.screening import candidates
from estimator.offline.search.trial import Setting, fit_names


def thinned(drives: dict[str, Any]) -> Record:
    """Every twelfth window of a drive without effects, four to a lap."""
    record = record_of(drives["none"])
    record = record.select(np.arange(record.windows) % 12 == 0)
    return replace(record, lap=np.arange(record.windows) // 4)


def fitted(record: Record, name: str) -> tuple[Fit, int]:
    """The fit with one effect, and the row of its first parameter."""
    done = fit_names(Setting(record, "per_axle", PRIOR), [name], None)
    return done, next(b.parameters.start for b in done.predictor.blocks if b.effect.name == name)


def test_a_delay_within_a_sample_is_no_effect(drives: dict[str, Any]) -> None:
    assert not believed(fitted(thinned(drives), "steer_delay")[0], "steer_delay")


def test_a_sensor_place_without_kinematics_must_exceed_what_the_car_travels_in_a_sample(drives: dict[str, Any]) -> None:
    record = replace(thinned(drives), used=np.array([True, True, True, True, False]))
    done, row = fitted(record, "imu_lever_arm")
    for place, named in ((0.1, False), (0.8, True)):
        parameters = done.parameters.copy()
        parameters[row : row + 2] = place, 0.0
        assert believed(replace(done, parameters=parameters), "imu_lever_arm") == named


def test_a_speed_scale_that_positions_contradict_is_not_believed(drives: dict[str, Any]) -> None:
    record = record_of(drives["none"])
    record = record.select(np.arange(record.windows) % 12 == 0)
    record = replace(record, lap=np.arange(record.windows) // 4)
    signals = {name: signal for name, signal in record.signals.items() if name != "x"}
    for own, named in ((record, False), (replace(record, signals=signals), True)):
        done = fit_names(Setting(own, "per_axle", PRIOR), ["speed_scale"], None)
        parameters = done.parameters.copy()
        parameters[next(b.parameters.start for b in done.predictor.blocks if b.effect.name == "speed_scale")] = 1.06
        assert believed(replace(done, parameters=parameters), "speed_scale") == named


def test_a_gain_of_a_gyroscope_that_the_heading_contradicts_is_not_believed(drives: dict[str, Any]) -> None:
    record = thinned(drives)
    turned = {**record.signals, "yaw": record.signals["yaw"] / 1.06}
    for own, named in ((record, False), (replace(record, signals=turned), True)):
        done, row = fitted(own, "gyro_gain")
        parameters = done.parameters.copy()
        parameters[row] = 1.06
        assert believed(replace(done, parameters=parameters), "gyro_gain") == named


def test_a_lag_of_the_drive_that_tyres_have_by_themselves_is_not_believed(drives: dict[str, Any]) -> None:
    done, row = fitted(thinned(drives), "drive_lag")
    for lag, named in ((0.03, False), (0.1, True)):
        parameters = done.parameters.copy()
        parameters[row] = lag
        assert believed(replace(done, parameters=parameters), "drive_lag") == named


def test_a_scale_of_the_brakes_is_no_sign_of_brakes_at_the_front(drives: dict[str, Any]) -> None:
    done, row = fitted(thinned(drives), "front_brake")
    for share, named in ((0.0, False), (0.5, True)):
        parameters = done.parameters.copy()
        parameters[row : row + 2] = share, 0.7
        off = replace(done, parameters=parameters)
        assert there(off, "front_brake") == named
        assert insignificant(off, done.covariance, ("front_brake",), LEAST_ERRORS) == (
            () if named else ("front_brake",)
        )


def test_the_steering_scale_is_not_tried_where_the_place_of_vy_is_fitted(drives: dict[str, Any]) -> None:
    record = record_of(drives["none"])
    for displaced in (False, True):
        tried = {effect.name for effect in candidates(replace(record, vy_displaced=displaced), ())}
        assert ("steer_scale" in tried) == (not displaced)


def test_a_zero_of_the_gyroscope_must_show_in_the_course_of_the_positions(drives: dict[str, Any]) -> None:
    record = record_of(drives["flat"])
    record = record.select(np.arange(record.windows) % 4 == 0)
    record = replace(record, lap=np.arange(record.windows) // 8)
    off = record.measured + np.array([0.0, 0.3, 0.02, 0.0, 0.0])[:, None]
    signals = {**record.signals, "yaw_rate": record.signals["yaw_rate"] + 0.02}
    turned = replace(record, measured=off, signals=signals)
    done = fit_names(Setting(turned, "per_axle", PRIOR), ["imu_bias"], None)
    assert believed(done, "imu_bias")
    zero = next(b.parameters for b in done.predictor.blocks if b.effect.name == "imu_bias").start + 2
    assert done.parameters[zero] == pytest.approx(0.02, abs=0.002)
    other = np.where(np.arange(len(done.parameters)) == zero, 0.03, done.parameters)
    assert not believed(replace(done, parameters=other), "imu_bias")


def test_a_grade_that_ends_the_lap_at_another_height_is_not_believed(drives: dict[str, Any]) -> None:
    record = record_of(drives["hilly"])
    record = record.select(np.arange(record.windows) % 4 == 0)
    record = replace(record, lap=np.arange(record.windows) // 8)
    done = fit_names(Setting(record, "per_axle", PRIOR), ["road_bank", "road_grade"], None)
    assert believed(done, "road_grade")
    parameters = done.parameters.copy()
    parameters[next(b.parameters for b in done.predictor.blocks if b.effect.name == "road_grade")] -= 0.04
    assert not believed(replace(done, parameters=parameters), "road_grade")


def test_a_bank_no_larger_than_what_the_springs_repeat_is_not_believed(drives: dict[str, Any]) -> None:
    record = record_of(drives["hilly"])
    record = record.select(np.arange(record.windows) % 4 == 0)
    done = fit_names(Setting(record, "per_axle", PRIOR), ["road_bank", "road_grade"], None)
    rows = next(b.parameters for b in done.predictor.blocks if b.effect.name == "road_bank")
    normal = replace(done.normal, prior=1e6 * done.normal.prior)
    for angle, named in ((0.7 * LEAST_ANGLE, False), (1.6 * LEAST_ANGLE, True)):
        parameters = done.parameters.copy()
        parameters[rows] *= angle / (0.5 * np.ptp(parameters[rows]))
        assert believed(replace(done, parameters=parameters, normal=normal), "road_bank") == named


@pytest.mark.parametrize(
    ("road", "slope", "halved"), [("road_bank", Quantity.BANK, 6), ("road_grade", Quantity.GRADE, 4)]
)
def test_a_road_that_kinematics_do_not_show_is_not_believed_whatever_else_it_does(
    drives: dict[str, Any], road: str, slope: Quantity, halved: int
) -> None:
    record = record_of(drives["hilly"])
    done = fit_names(Setting(record, "per_axle", PRIOR), [road], None)
    rows = next(b.parameters for b in done.predictor.blocks if b.effect.name == road)
    assert share_in_kinematics(record, slope, done.parameters[rows]) == pytest.approx(1.0, abs=0.1)
    assert believed(done, road)
    moved = done.parameters.copy()
    moved[rows] = np.roll(moved[rows], (rows.stop - rows.start) // halved)  # half a wave, of three or two over the lap
    assert not believed(replace(done, parameters=moved), road)


def test_load_transfer_lower_or_higher_than_in_any_car_is_not_believed(drives: dict[str, Any]) -> None:
    record = record_of(drives["none"])
    done = fit_names(Setting(record, "per_axle", PRIOR), ["load_transfer"], None)
    row = next(b.parameters.start for b in done.predictor.blocks if b.effect.name == "load_transfer")
    normal = replace(done.normal, prior=done.normal.prior + 1e8 * np.eye(len(done.parameters)))
    for height, named in ((0.03, False), (0.3, True), (0.66, False)):
        parameters = done.parameters.copy()
        parameters[row] = height
        assert believed(replace(done, parameters=parameters, normal=normal), "load_transfer") == named


def test_no_more_lift_than_any_body_has_is_not_believed(drives: dict[str, Any]) -> None:
    done = fit_names(Setting(record_of(drives["none"]), "per_axle", PRIOR), ["aero_downforce"], None)
    rows = next(b.parameters for b in done.predictor.blocks if b.effect.name == "aero_downforce")
    normal = replace(done.normal, prior=done.normal.prior + 1e8 * np.eye(len(done.parameters)))
    for k, named in ((0.02, False), (0.3, True)):
        parameters = done.parameters.copy()
        parameters[rows] = k
        assert believed(replace(done, parameters=parameters, normal=normal), "aero_downforce") == named
