"""Bring-up check: what the values say, at rest and pushed around a bend."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.cars import check_traffic
from support.cars.check_traffic import CODEC, SECONDS, Change, Values, edit, finding, report, traffic, trouble

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.gateway.check.finding import Verdict


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (edit("imu_3", imu_az=-GRAVITY), "gravity, imu.main", "up is along -z"),
        (edit("imu_3", imu_az=0.5 * GRAVITY), "gravity, imu.main", "0.50 g in all"),
        (edit("imu_3", imu_az=GRAVITY), "imu.main.az", "in all 200 frames"),
        (edit("imu_1", imu_yaw_rate=0.1), "imu.main.yaw_rate", "+5.73 deg/s"),
        (edit("steering_report_extd", average_steering_ang_fdbk=1.0), "steering centre", "+57.5 deg"),
        (edit("steering_report_extd", secondary_steering_ang_fdbk=0.2), "steering sensors", "apart"),
        (edit("misc_report", battery_voltage=3.0), "battery_voltage", "3 to 3 V, possible are 9 to 16"),
        (edit("base_to_car_summary", base_to_car_heartbeat=3), "race-control heartbeat", "frozen at 3"),
        (edit("novatel_report", novatel_lat=0.0, novatel_long=0.0), "position", "no fix"),
        (edit("novatel_report", novatel_lat=0.7, novatel_long=-1.5), "position", "km from the map's origin"),
    ],
)
def test_implausible_values_at_rest_are_named(change: Change, name: str, words: str) -> None:
    result = report(traffic(change))
    assert name in trouble(result)
    assert any(words in item.detail for item in result.findings if item.name == name)


def pushed(steer_sign: float = 1.0, yaw_sign: float = 1.0, ax_sign: float = 1.0, swap: bool = False) -> Change:
    """Pushed to 2 m/s and slowed down again in a left bend of 12 m radius at the rear axle."""

    def change(name: str, t: float, values: Values) -> Values:
        speed = 2 * math.sin(math.pi * t / SECONDS) ** 2
        yaw = speed / 12.0
        inner, outer = speed - yaw * 1.523 / 2, speed + yaw * 1.523 / 2
        left, right = (outer, inner) if swap else (inner, outer)
        new = {
            "wheel_speed_FL": left, "wheel_speed_RL": left, "wheel_speed_FR": right, "wheel_speed_RR": right,
            "imu_yaw_rate": yaw_sign * yaw, "average_steering_ang_fdbk": steer_sign * 15 * math.atan(2.972 / 12.0),
            "imu_ax": ax_sign * 2 * math.pi / SECONDS * math.sin(2 * math.pi * t / SECONDS),
        }  # fmt: skip
        return values | {signal: value for signal, value in new.items() if signal in values}

    return change


SIGNS = ("yaw rate against wheels", "yaw rate against steering", "acceleration against wheels")


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (pushed(), set()),
        (pushed(yaw_sign=-1), {SIGNS[0], SIGNS[1]}),
        (pushed(steer_sign=-1), {SIGNS[1]}),
        (pushed(ax_sign=-1), {SIGNS[2]}),
        (pushed(swap=True), {SIGNS[0]}),
    ],
)
def test_wrong_signs_show_when_the_car_is_pushed(change: Change, wrong: set[str]) -> None:
    result = report(traffic(change))
    assert {name for name in SIGNS if finding(result, name).verdict is Verdict.FAIL} == wrong
    assert finding(result, "wheel speeds").verdict is Verdict.OK


def test_a_dead_wheel_sensor_is_named_when_pushed() -> None:
    def change(name: str, t: float, values: Values) -> Values:
        values = pushed()(name, t, values)
        return values | {"wheel_speed_RR": 0.0} if name == "wheel_speed_report" else values

    assert finding(report(traffic(change)), "wheel speeds").remedy == "sensor of RR"


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, Verdict.OK), (0.5, Verdict.FAIL)])
def test_wheels_at_half_scale_are_named_by_the_positions(
    monkeypatch: pytest.MonkeyPatch, scale: float, verdict: Verdict
) -> None:
    """Pushed north at 1.5 m/s for 8 s; a degree of latitude is 110.9 km there."""
    monkeypatch.setattr(check_traffic, "SECONDS", 8.0)

    def change(name: str, t: float, values: Values) -> Values:
        wheels = {f"wheel_speed_{wheel}": 1.5 * scale for wheel in ("FL", "FR", "RL", "RR")}
        new = {**wheels, "novatel_lat": math.radians(36.585 + 1.5 * t / 110_955)}
        return values | {signal: value for signal, value in new.items() if signal in values}

    found = finding(report(traffic(change)), "speed against positions")
    assert found.verdict is verdict
    if verdict is Verdict.FAIL:
        assert "by the wheels" in found.detail
        assert "scale of the wheel speeds" in found.remedy


def test_swapped_bytes_of_the_imu_are_one_finding_a_message() -> None:
    """A sender with the other byte order; the accelerations are in two messages, one of them with the yaw rate."""
    imu = {CODEC.messages[name].id for name in ("imu_1", "imu_2", "imu_3")}
    frames = [replace(f, data=_swapped(f.data)) if f.id in imu else f for f in traffic()]
    named = {name for name in trouble(report(frames)) if "imu" in name}
    assert named == {"byte order, imu_1", "byte order, imu_2", "byte order, imu_3"}


def _swapped(data: bytes) -> bytes:
    """The bytes of each 16-bit word in the other order."""
    return b"".join(data[i : i + 2][::-1] for i in range(0, len(data), 2))


def test_a_sign_that_chance_explains_is_not_told() -> None:
    """Pushed around the bend with an accelerometer that shows nothing but noise."""
    rng = np.random.default_rng(5)

    def change(name: str, t: float, values: Values) -> Values:
        values = pushed()(name, t, values)
        return values | {"imu_ax": 0.3 * rng.standard_normal()} if name == "imu_2" else values

    assert finding(report(traffic(change)), SIGNS[2]).verdict is Verdict.INFO
