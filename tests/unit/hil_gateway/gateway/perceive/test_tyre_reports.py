"""Tyre reports reach the bus, and a tyre without air stops the car."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.bus.topics import TYRES
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.gateway.act.stopping import FLAT_GRIP

WHEELS = ("FL", "FR", "RL", "RR")
SOUND_MBAR, FLAT_MBAR = 2600.0, 1050.0
Readings = Callable[[int], dict[str, float]]


def reporting(mbar: Readings) -> Rig:
    """A car that sends `mbar(tick)` as absolute pressures at 10 Hz."""
    rig = Rig()

    def send(rig: Rig) -> None:
        if rig.car.tick % 10 == 0:
            for wheel, value in mbar(rig.car.tick).items():
                signals = {f"{wheel}_Tire_Pressure": value, f"{wheel}_Tire_Pressure_Gauge": value - 1013.0}
                rig.car.send(f"Tire_Pressure_{wheel}", signals)

    rig.hooks.append(send)
    return rig


def driving(seconds: float) -> tuple[Rig, dict[str, float]]:
    """A car after `seconds` of driving on sound tyres, and the pressures it goes on to report."""
    pressures = dict.fromkeys(WHEELS, SOUND_MBAR)
    rig = reporting(lambda tick: pressures)
    rig.drive = 0.1
    rig.drive_off(seconds)
    return rig, pressures


@pytest.mark.parametrize("wheel", WHEELS)
def test_a_puncture_of_any_tyre_stops_the_car_with_its_first_report(wheel: str) -> None:
    rig, pressures = driving(2.0)
    assert rig.action is FailsafeAction.DRIVE
    pressures[wheel] = FLAT_MBAR
    rig.run(0.12)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "tyre_flat")


def test_a_report_of_which_one_value_says_flat_stops_the_car_when_it_says_so_for_a_while() -> None:
    rig = Rig()
    absolute = [SOUND_MBAR]

    def send(rig: Rig) -> None:
        if rig.car.tick % 10 == 0:
            rig.car.send("Tire_Pressure_RL", {"RL_Tire_Pressure": absolute[0], "RL_Tire_Pressure_Gauge": 1587.0})

    rig.hooks.append(send)
    rig.drive_off(2.0)
    absolute[0] = FLAT_MBAR
    rig.run(0.2)
    assert rig.action is FailsafeAction.DRIVE
    rig.run(0.3)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "tyre_flat")


def test_a_stop_with_a_flat_tyre_brakes_with_all_that_it_leaves() -> None:
    rig, pressures = driving(12.0)
    pressures["FL"] = FLAT_MBAR
    rig.run(0.5)
    config = Config()
    pressed_pa = 1e3 * sum(rig.car.commands[f"{axle}_brake_pressure_cmd"] for axle in "FR")
    deceleration = pressed_pa * config.powertrain.brake_force_per_pa / config.vehicle.mass
    assert deceleration > FLAT_GRIP * config.gateway.stop.lateral_grip * GRAVITY
    assert deceleration > 1.4 * config.gateway.stop.controlled_deceleration


@pytest.mark.parametrize(
    ("name", "mbar"),
    [
        ("no sensors", lambda tick: {}),
        ("sensors that read nothing", lambda tick: dict.fromkeys(WHEELS, 0.0)),
        ("a sensor that dies", lambda tick: dict.fromkeys(WHEELS, SOUND_MBAR if tick < 1000 else 0.0)),
        ("one wrong frame in fifty", lambda tick: dict.fromkeys(WHEELS, 5900.0 if tick % 500 == 0 else SOUND_MBAR)),
        ("an overflow", lambda tick: dict.fromkeys(WHEELS, 65535.0 if tick % 20 == 0 else SOUND_MBAR)),
        ("tyres that warm up", lambda tick: dict.fromkeys(WHEELS, SOUND_MBAR + 0.1 * tick)),
    ],
)
def test_what_is_no_puncture_does_not_stop_the_car(name: str, mbar: Readings) -> None:
    rig = reporting(mbar)
    rig.drive_off()
    rig.run(10.0)
    assert rig.action is FailsafeAction.DRIVE, name


def test_temperatures_and_pressures_are_published_and_what_is_not_reported_is_null() -> None:
    rig = reporting(lambda tick: {"FL": SOUND_MBAR})
    subscription = rig.bus.subscribe(TYRES, depth=100)
    points = {f"FL_Tire_Temp_{point:02d}": 70.0 + point for point in range(1, 17)}

    def warm(rig: Rig) -> None:
        if rig.car.tick % 10 == 0:
            for number in range(1, 5):
                rig.car.send(f"Tire_Temp_FL_{number}", points)

    rig.hooks.append(warm)
    rig.run(2.0)
    messages = subscription.poll(rig.clock.now_ns())
    assert 9 <= len(messages) <= 11
    newest = messages[-1]
    assert newest.temperature == (pytest.approx(78.5, abs=0.1), None, None, None)
    assert newest.hottest[0] == pytest.approx(86.0, abs=0.1)
    assert newest.pressure == (pytest.approx(158_700.0, abs=100.0), None, None, None)


@pytest.mark.parametrize(("wheel", "braked"), [("FL", True), ("RR", False)])
def test_a_stop_with_a_flat_rear_tyre_brakes_in_front_alone(wheel: str, braked: bool) -> None:
    rig, pressures = driving(12.0)
    pressures[wheel] = FLAT_MBAR
    rig.run(0.5)
    assert rig.car.commands["F_brake_pressure_cmd"] > 1000.0
    assert (rig.car.commands["R_brake_pressure_cmd"] > 1000.0) is braked


@pytest.mark.parametrize("mbar", [FLAT_MBAR, SOUND_MBAR])
def test_a_car_that_slides_on_a_flat_tyre_keeps_its_gyro(mbar: float) -> None:
    """Yaw rate and lateral force do not fit each other then: that is the slide, and the gyro is what can catch it."""
    rig, pressures = driving(12.0)
    pressures["RR"] = mbar
    rig.run(0.4)
    rig.hooks.append(lambda rig: rig.car.overrides.update(imu_yaw_rate=40.0))
    rig.run(0.5)
    assert rig.gateway.monitors.imu_wrong is (mbar == SOUND_MBAR)
