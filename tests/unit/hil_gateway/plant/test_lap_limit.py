"""The least lap time of the simulated car agrees with what the plant itself does."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.driving.laps import drive
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.car import Car, Commands
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.plant.physics.parameters import AV24
from hil_gateway.plant.physics.road import Slopes
from hil_gateway.plant.referee import limit_envelope, limit_line
from hil_gateway.plant.referee.lap_limit import lap_limit
from hil_gateway.plant.referee.limit_envelope import LimitEnvelope, Side, best_ratio, measure_envelope
from hil_gateway.plant.referee.limit_line import A0, POWERS, V0, fastest_line, fit
from hil_gateway.plant.referee.limit_profile import LimitPath as Line
from hil_gateway.plant.referee.limit_profile import fastest_profile, lap_time, reach
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.cli.plan import app

LAYOUT = """
name = "stadium"
width = 10.0
[[segment]]
straight = 150.0
[[segment]]
corner = {turn}
radius = 40.0
transition = 25.0
[[segment]]
straight = 300.0
[[segment]]
corner = {turn}
radius = 40.0
transition = 25.0
[[segment]]
straight = 150.0
"""
PLAIN = np.zeros(400)


@pytest.fixture(scope="module")
def envelope() -> Iterator[LimitEnvelope]:
    """Of roads that are level, as all are here: around the weight of the car, without crests and banked turns."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (limit_envelope, limit_line):
            patch.setattr(module, "NORMALS", GRAVITY * np.array([0.6, 1.0, 1.5]))
        yield measure_envelope(AV24)


@pytest.mark.parametrize(("effect", "size", "speed", "weights"), [
    ("load_sensitivity", 0.3, 17.0, 2.2), ("turn_asymmetry", 0.06, 9.0, 1.5),
])  # fmt: skip
def test_a_car_that_holds_less_than_most_of_the_load_on_its_tyres_has_a_limit_too(
    effect: str, size: float, speed: float, weights: float
) -> None:
    car = SimulatedCar(grip_front=0.84, grip_rear=0.9, effects={effect: size})
    most = Side(car.parameters(), 1.0, 1.0).measure(0.0, speed, weights * GRAVITY)[0]
    assert 0.45 * weights * GRAVITY < most < 0.8 * weights * GRAVITY


def _stadium(folder: Path, turn: float = 180.0) -> Track:
    path = folder / f"stadium{turn:g}.toml"
    path.write_text(LAYOUT.format(turn=turn))
    return load_track(path)


def _flat(folder: Path) -> Track:
    """Room to turn on: a circle of 2 km radius, level."""
    angle = np.arange(400) * 2 * np.pi / 400
    rows = [f"{2000 * np.cos(a):.3f},{2000 * np.sin(a):.3f},90,90" for a in angle]
    path = folder / "flat.csv"
    path.write_text("\n".join(["x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]))
    return load_track(path)


def _gear(speed: float) -> int:
    return [g * AV24.final_drive for g in AV24.gears].index(best_ratio(AV24, speed)) + 1


def _ramp_steer(track: Track, speed: float) -> float:
    """Largest lateral force over mass, m/s2, that the plant holds at a constant speed while the wheel is turned slowly:
    the mean of the best half second before it slides or slows down."""
    car = Car(AV24, track, speed=speed)
    history = []
    for step in range(14_000):
        pedal = min(max(0.15 + 0.5 * (speed - car["vx"]), 0.02), 1.0)
        car.step(Commands(steer=1.3e-5 * step, throttle=pedal, gear=_gear(speed)), engine_running=True)
        if abs(car["vx"] - speed) > 1.0 or abs(car["vy"] / car["vx"]) > 0.3:
            break
        history.append(car.output("ay"))
    return float(np.convolve(history, np.full(500, 1 / 500), "valid").max())


@pytest.mark.parametrize("speed", [pytest.param(25.0, marks=pytest.mark.long), 40.0])
def test_circle_is_lapped_at_the_speed_where_the_plant_begins_to_slide(
    envelope: LimitEnvelope, tmp_path: Path, speed: float
) -> None:
    held = _ramp_steer(_flat(tmp_path), speed)
    radius = speed**2 / held  # the circle on which the plant slides at this speed
    line = Line(2.0, PLAIN, PLAIN, PLAIN + 1 / radius, Slopes(PLAIN, PLAIN, PLAIN))
    v = fastest_profile(line, envelope, AV24.car)
    assert v.max() - v.min() < 0.5
    assert v.mean() == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize("speed", [35.0, 60.0])
def test_straight_line_acceleration_is_that_of_the_plant(envelope: LimitEnvelope, tmp_path: Path, speed: float) -> None:
    car = Car(AV24, _flat(tmp_path), speed=speed - 3.0)
    while car["vx"] < speed:
        car.step(Commands(throttle=1.0, gear=_gear(speed)), engine_running=True)
    line = Line(2.0, PLAIN, PLAIN, PLAIN, Slopes(PLAIN, PLAIN, PLAIN))
    can = reach(line, envelope, AV24.car).rise[0]
    assert np.interp(speed, np.linspace(9.0, 80.0, len(can)), can) == pytest.approx(car.output("ax"), rel=0.04)


def test_full_braking_of_the_plant_is_never_stronger_than_its_limit(envelope: LimitEnvelope, tmp_path: Path) -> None:
    line = Line(2.0, PLAIN, PLAIN, PLAIN, Slopes(PLAIN, PLAIN, PLAIN))
    most = -np.interp(50.0, np.linspace(9.0, 80.0, 143), reach(line, envelope, AV24.car).fall[0])
    best = 0.0
    for pressure in np.linspace(1.5e6, AV24.pressure_max, 12):
        car = Car(AV24, _flat(tmp_path), speed=56.0)
        while car["vx"] > 50.0:
            car.step(Commands(brake_front=float(pressure), brake_rear=float(0.85 * pressure), gear=5), True)
        best = max(best, -car.output("ax"))
    assert 0.9 * most < best < 1.01 * most


@pytest.mark.parametrize("speed", [40.0, 60.0, 80.0])
def test_what_shapes_the_line_knows_grip_and_drag_of_cornering(envelope: LimitEnvelope, speed: float) -> None:
    v, level, found = np.array([speed]), np.array([GRAVITY]), fit(envelope)
    lateral, drag = (
        A0 * sum(c * (speed / V0) ** power for c, (power, _) in zip(row, POWERS, strict=True))
        for row in (found.lateral, found.drag)
    )
    calm = np.zeros(1)
    assert lateral == pytest.approx(envelope.peak(calm < 0, calm, v, level)[0], rel=0.02)
    assert drag == pytest.approx(-envelope.along(envelope.drive, calm + 1, calm, v, level)[0], abs=1.0)


def test_mirrored_track_has_the_same_limit(envelope: LimitEnvelope, tmp_path: Path) -> None:
    times = []
    for turn in (180.0, -180.0):
        line = fastest_line(_stadium(tmp_path, turn), AV24, envelope, 0.95)
        times.append(lap_time(fastest_profile(line, envelope, AV24.car), line.step))
    assert times[0] == pytest.approx(times[1], rel=1e-3)


@pytest.mark.long
def test_more_grip_and_more_power_are_faster_and_the_plant_never_laps_below_its_limit(tmp_path: Path) -> None:
    track = _stadium(tmp_path)
    limit, slippery = lap_limit(AV24, track).limit_s, lap_limit(AV24, track, 0.9).limit_s
    weak = replace(AV24, car=replace(AV24.car, engine_torque=tuple(0.9 * t for t in AV24.car.engine_torque)))
    assert 1.03 * limit < slippery < limit / 0.9
    assert limit < lap_limit(weak, track).limit_s
    driven = drive(base="av24", laps=3, track=track, levels=(0.8, 0.95)).lap_times_s
    assert limit < min(driven) < 1.5 * limit


@pytest.mark.long
def test_limit_command_reports_both_times(tmp_path: Path) -> None:
    _stadium(tmp_path)
    (tmp_path / "car.json").write_text(json.dumps({"grip_front": 0.9, "grip_rear": 0.9}))
    arguments = ["limit", "--track", str(tmp_path / "stadium180.toml"), "--json", "--car", str(tmp_path / "car.json")]
    result = CliRunner().invoke(app, arguments)
    report = json.loads(result.output)
    assert report["limit_s"] < report["limit_90_s"]
    assert report["limit_s"] == pytest.approx(lap_limit(AV24, _stadium(tmp_path), 0.9).limit_s, rel=2e-3)
    assert 20.0 < report["peak_speed_mps"] <= 80.0
