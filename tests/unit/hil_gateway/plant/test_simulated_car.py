"""Simulated cars from files, what happens to them, and how the plant judges their loads."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.drives.sloped_track import place_of, sloped_track
from support.promise_figures import record_figure, volume

from benchmarks.driving.random_car import random_car, with_other_noise
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.demo.drive import _with_arguments
from hil_gateway.demo.options import DemoOptions, prepare
from hil_gateway.plant.car import Car, Commands
from hil_gateway.plant.car_file import SimulatedCar, read_car
from hil_gateway.plant.physics.parameters import AV24
from hil_gateway.plant.referee.judge import LoadJudge
from hil_gateway.plant.referee.referee import Referee
from hil_gateway.process.errors import InputError
from hil_gateway.process.supervisor import PROCESSES
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

EXAMPLE = {
    "base": "av24", "grip_front": 0.9, "grip_rear": 1.1, "mass": 810, "yaw_inertia": 1080, "cg_x": 0.03,
    "downforce": 0.9, "drag": 1.1, "brake_gain": 0.95, "engine_torque": 0.95, "effects": {"wind": 8.0},
    "noise": {"position": 2.0},
    "events": [{"kind": "grip", "t": 40, "for_s": 6, "factor": 0.7},
               {"kind": "gust", "t": 90, "for_s": 2, "force_n": 1500}, {"kind": "puncture", "t": 120, "wheel": "rl"}],
}  # fmt: skip


def _file(folder: Path, content: dict[str, Any]) -> Path:
    path = folder / "car.json"
    path.write_text(json.dumps(content))
    return path


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> Track:
    """A level circle of 2 km radius, wide enough to turn on."""
    angle = np.arange(400) * 2 * np.pi / 400
    rows = [f"{2000 * np.cos(a):.3f},{2000 * np.sin(a):.3f},90,90" for a in angle]
    path = tmp_path_factory.mktemp("flat") / "flat.csv"
    path.write_text("\n".join(["x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]))
    return load_track(path)


def test_every_key_of_a_car_file_changes_the_car_as_it_says(tmp_path: Path) -> None:
    simulated = read_car(_file(tmp_path, EXAMPLE))
    car, usual = simulated.parameters().car, AV24.car
    assert (car.grip_front, car.grip_rear, car.mass, car.yaw_inertia, car.wind_x) == (0.9, 1.1, 810, 1080, 8.0)
    assert (car.lf, car.lr) == pytest.approx((usual.lf - 0.03, usual.lr + 0.03))
    assert (car.downforce, car.drag) == pytest.approx((0.9 * usual.downforce, 1.1 * usual.drag))
    assert car.brake_gain_front == pytest.approx(0.95 * usual.brake_gain_front)
    assert car.engine_torque == pytest.approx([0.95 * t for t in usual.engine_torque])
    sensors, usual_sensors = simulated.parameters().sensors, AV24.sensors
    assert sensors == replace(usual_sensors, position_noise=2.0 * usual_sensors.position_noise)
    assert [event.kind for event in simulated.events] == ["grip", "gust", "puncture"]


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ({"gripp": 1.0}, "gripp"),
        ({"mass": -5}, "mass"),
        ({"noise": {"gyro": 2.0}}, "noise.gyro"),
        ({"effects": {"ghost": 1.0}}, "ghost"),
        ({"events": [{"kind": "grip", "factor": 0.7, "when": 3}]}, "when"),
        ({"events": [{"kind": "meteor", "t": 3}]}, "events"),
        ({"events": [{"kind": "puncture", "t": 3, "wheel": "left"}]}, "wheel"),
    ],
)
def test_broken_car_files_name_file_and_key(tmp_path: Path, content: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=rf"car\.json.*{named}"):
        read_car(_file(tmp_path, content))


def test_random_cars_stay_in_their_ranges_and_repeat_with_their_seed() -> None:
    cars = [random_car(seed) for seed in range(200)]
    assert cars[3] == random_car(3) != cars[4]
    grips = np.array([[car.grip_front, car.grip_rear] for car in cars])
    assert 0.8 <= grips.min() < 0.83
    assert 1.17 < grips.max() <= 1.2
    mass_off = np.abs(np.array([car.mass or 0.0 for car in cars]) / AV24.car.mass - 1.0)
    assert 0.049 < mass_off.min() < 0.06
    assert 0.09 < mass_off.max() < 0.101
    assert all(abs(car.brake_gain - 1.0) <= 0.1 and abs(car.engine_torque - 1.0) <= 0.1 for car in cars)


def test_sensors_of_a_random_car_have_half_to_twice_the_noise() -> None:
    cars = [with_other_noise(random_car(seed), seed) for seed in range(200)]
    assert cars[3] == with_other_noise(random_car(3), 3) != random_car(3)
    factors = np.array([list(car.noise.model_dump().values()) for car in cars])
    assert 0.5 <= factors.min() < 0.51
    assert 1.95 < factors.max() <= 2.0
    assert np.abs(np.corrcoef(factors.T) - np.eye(5)).max() < 0.25


def test_only_the_plant_is_told_of_the_car(tmp_path: Path) -> None:
    path = _file(tmp_path, EXAMPLE)
    options = DemoOptions(car=path, out=tmp_path / "out")
    setup = prepare(options)
    with setup.lock:
        written = setup.config_file.read_text()
    assert str(path) not in written
    assert "810" not in written
    assert [spec.name for spec in PROCESSES if _with_arguments(spec, options, setup).arguments] == ["plant"]
    with pytest.raises(InputError, match="leave out --effect"):
        prepare(DemoOptions(car=path, effects=("wind=3",), out=tmp_path / "out"))


def _brake(track: Track, events: list[dict[str, Any]], seconds: float = 1.0) -> Car:
    simulated = SimulatedCar.model_validate({"events": events})
    car = Car(simulated.parameters(), track, speed=40.0, events=simulated.events)
    for _ in range(round(1000 * seconds)):
        car.step(Commands(brake_front=1.5e6, brake_rear=1.3e6, gear=4), engine_running=True)
    return car


def test_brake_fade_takes_its_share_of_the_braking(flat: Track) -> None:
    sound, faded = _brake(flat, []), _brake(flat, [{"kind": "brake_fade", "t": 0, "factor": 0.5}])
    loss = [40.0 - car["vx"] for car in (sound, faded)]
    assert 0.5 < loss[1] / loss[0] < 0.65  # drag and engine brake as before


def test_gust_pushes_by_its_force_and_ends(flat: Track) -> None:
    simulated = SimulatedCar.model_validate({"events": [{"kind": "gust", "t": 0.2, "for_s": 0.1, "force_n": 1500}]})
    car = Car(AV24, flat, speed=40.0, events=simulated.events)
    felt = []
    for _ in range(600):
        car.step(Commands(throttle=0.3, gear=4), engine_running=True)
        felt.append(car.output("ay"))
    assert felt[210] - felt[190] == pytest.approx(1500 / AV24.car.mass, rel=0.1)
    assert abs(felt[550]) < 0.2


def test_puncture_pulls_the_car_to_its_side_and_stays(flat: Track) -> None:
    car = _brake(flat, [{"kind": "puncture", "t": 0.0, "wheel": "fl"}], 0.8)
    assert car["yaw_rate"] > 0.003 + abs(_brake(flat, [], 0.8)["yaw_rate"])


@pytest.mark.slow
@pytest.mark.promise("G2")
@pytest.mark.parametrize(("grade", "bank_deg"), [(0.2, 0.0), (-0.2, 0.0), (0.0, 20.0)])
def test_brakes_hold_a_standing_car_to_the_millimetre(grade: float, bank_deg: float) -> None:
    car, parked = Car(AV24, sloped_track(), start_s=place_of(grade, bank_deg)), Commands(0.0, 0.0, 1e6, 1e6)
    for _ in range(2000):  # tyres and brakes take the load
        car.step(parked, engine_running=False)
    x, y, yaw = car["x"], car["y"], car["yaw"]
    minutes = volume(1, 10)
    for _ in range(60_000 * minutes):
        car.step(parked, engine_running=False)
    crept = np.hypot(car["x"] - x, car["y"] - y)
    assert crept < 1e-3
    assert abs(car["yaw"] - yaw) < 1e-4
    assert np.hypot(car.output("ax"), car.output("ay")) == pytest.approx(
        GRAVITY * np.sin(np.hypot(np.arctan(grade), np.radians(bank_deg))), rel=0.03
    )
    where = f"{100 * grade:.0f} % of grade" if grade else f"{bank_deg:.0f} deg of bank"
    record_figure("G2", f"plant, {where}, 1 MPa, {minutes} min: crept {1e6 * crept:.2f} micrometres")


def test_the_referee_times_laps_from_line_to_line_and_the_first_from_when_the_car_drives_off() -> None:
    """Brakes hold it on a grade, where it creeps by micrometres; crossings lie between two looks."""
    car = Car(AV24, sloped_track(), start_s=place_of(0.2, 0.0))
    referee, start, length = Referee(car), car.road.s, car.road.track.length
    for second in range(10):
        for _ in range(1000):
            car.step(Commands(0.0, 0.0, 1e6, 1e6), engine_running=False)
        referee.step(float(second))
    assert referee.distance_m > 0.0 and start > 50.0
    for tenths in range(1, round(0.2 * (3.0 * length - start)) + 2):  # carried round at 50 m/s
        car.place((start + 5.0 * tenths) % length, speed=50.0)
        referee.step(10.0 + 0.1 * tenths)
    assert referee.lap_times_s == pytest.approx([length / 50.0] * 2, abs=1e-3)


def test_a_standing_car_without_brakes_rolls_down() -> None:
    car = Car(AV24, sloped_track(), start_s=place_of(0.12))
    for _ in range(3000):
        car.step(Commands(), engine_running=False)
    assert car["vx"] == pytest.approx(-GRAVITY * 0.119 * 3.0, rel=0.15)


@pytest.mark.parametrize("speed", [1.0, -1.0])
@pytest.mark.parametrize("grade", [0.0, -0.12])
def test_a_crew_pushes_a_braked_car_and_lets_it_stand_again(speed: float, grade: float) -> None:
    event = {"kind": "push", "t": 2.0, "for_s": 10.0, "speed": speed}
    simulated = SimulatedCar.model_validate({"events": [event]})
    car = Car(AV24, sloped_track(), start_s=place_of(grade), events=simulated.events)
    at = {}
    for step in range(16_000):
        car.step(Commands(brake_front=1e6, brake_rear=1e6), engine_running=False)
        at[step] = car.road.s
    assert abs(at[1999] - at[1000]) < 1e-3
    assert 6.0 < (at[11_999] - at[2000]) * np.sign(speed) < 13.0, "uphill a crew is slower than it means to be"
    assert abs(at[15_999] - at[13_500]) < 2e-3


def _turn(track: Track, events: list[dict[str, Any]], steer: float, seconds: float = 2.0) -> LoadJudge:
    simulated = SimulatedCar.model_validate({"events": events})
    car = Car(AV24, track, speed=30.0, events=simulated.events)
    judge = LoadJudge(car)
    for step in range(round(1000 * seconds)):
        car.step(Commands(steer=min(steer, 1e-3 * step * steer), throttle=0.2, gear=3), engine_running=True)
        judge.step()
    return judge


def test_friction_used_grows_with_the_turn_and_a_hard_turn_in_the_wet_slides(flat: Track) -> None:
    gentle, fast = _turn(flat, [], 0.01), _turn(flat, [], 0.035)
    assert 0.05 < gentle.friction[0] < fast.friction[0] < 1.0
    assert fast.longest_over_s == 0.0
    wet = [{"kind": "grip", "t": 0.5, "for_s": 9, "factor": 0.4}]
    assert max(_turn(flat, wet, 0.035).friction) > 1.2 * max(fast.friction)
    slid = _turn(flat, wet, 0.2)
    assert slid.longest_over_s > 0.2
    assert slid.slides >= 1
    assert 0.97 < max(slid.friction) <= 1.001


def test_full_throttle_in_a_low_gear_spins_the_car(flat: Track) -> None:
    car = Car(AV24, flat, speed=20.0)
    judge = LoadJudge(car)
    for step in range(3000):
        car.step(Commands(steer=0.08, throttle=float(step > 800), gear=1), engine_running=True)
        judge.step()
    assert judge.spins == 1
    assert judge.longest_over_s > 0.3


def test_wet_place_of_the_track_is_wet_on_every_lap_and_nowhere_else(flat: Track) -> None:
    from hil_gateway.plant.events import disturbance

    events = SimulatedCar.model_validate({"events": [{"kind": "grip", "s": 990, "for_m": 20, "factor": 0.7}]}).events
    grips = [disturbance(events, 50.0, s, 1000.0).grip for s in (980.0, 995.0, 5.0, 15.0)]
    assert grips == [1.0, 0.7, 0.7, 1.0]
