"""Every effect of the simulated car does what its table says, and nothing where it is off."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.driving.laps import Drive, EstimateNoise, drive
from hil_gateway.cli.plant import app, parse_effects
from hil_gateway.plant.physics.effects import SWITCHES, configure
from hil_gateway.plant.physics.parameters import AV24, PAPER, SensorParameters
from hil_gateway.process.errors import InputError

CAR = PAPER.car


def _drive(effects: dict[str, float] | None = None, seed: int = 3, seconds: float = 24.0) -> Drive:
    """From the climb through the Corkscrew."""
    return drive(effects, laps=1, seconds=seconds, start_s=1850.0, seed=seed, levels=(0.85, 0.85))


@pytest.fixture(scope="module")
def plain() -> Drive:
    return _drive()


def _single_track_error(d: Drive) -> tuple[float, ...]:
    """Root mean square of ax, ay, motion (m/s2) and yaw acceleration (rad/s2) that Eq. (1)-(3) leave."""
    c = d.columns
    front = c["steer"] - np.arctan((c["vy"] + CAR.lf * c["yaw_rate"]) / c["vx"])
    rear = -np.arctan((c["vy"] - CAR.lr * c["yaw_rate"]) / c["vx"])
    fy_f = CAR.df * CAR.static_load_front * np.sin(CAR.cf * np.arctan(CAR.bf * front))
    fy_r = CAR.dr * CAR.static_load_rear * np.sin(CAR.cr * np.arctan(CAR.br * rear))
    along = c["ax"] + fy_f * np.sin(c["steer"]) / CAR.mass
    cx = np.dot(along, c["drive"]) / np.dot(c["drive"], c["drive"])
    ay = c["ay"] - (fy_r + fy_f * np.cos(c["steer"])) / CAR.mass
    window = np.ones(50) / 50
    smooth = {name: np.convolve(c[name], window, "same") for name in ("vx", "vy")}
    motion_x = np.gradient(smooth["vx"], 0.01) - np.convolve(c["ax"] + c["vy"] * c["yaw_rate"], window, "same")
    motion_y = np.gradient(smooth["vy"], 0.01) - np.convolve(c["ay"] - c["vx"] * c["yaw_rate"], window, "same")
    motion = np.hypot(motion_x, motion_y)[100:-100]
    yaw_acc = np.gradient(np.convolve(c["yaw_rate"], window, "same"), 0.01)
    moment = np.convolve(fy_f * CAR.lf * np.cos(c["steer"]) - fy_r * CAR.lr, window, "same") / CAR.yaw_inertia
    return (
        float(np.std(along - cx * c["drive"])),
        float(np.std(ay)),
        float(np.sqrt(np.mean(motion**2))),
        float(np.std((yaw_acc - moment)[100:-100])),
    )


def test_paper_base_leaves_only_sensor_noise(plain: Drive) -> None:
    ax, ay, *_ = _single_track_error(plain)
    assert plain.off_track == 0
    assert ax < 0.125  # the accelerometer's own noise is 0.11 m/s2
    assert ay < 0.35  # with the noise of vy in the slip angles


def test_without_sensor_noise_the_paper_base_is_eq_1_to_3() -> None:
    silent = replace(PAPER, sensors=SensorParameters(0.0, 0.0, 0.0, 0.0, 0.0))
    d = drive(parameters=silent, noise=EstimateNoise(0, 0, 0, 0), seconds=36.0, start_s=1850.0, levels=(0.85, 0.85))
    ax, ay, motion, yaw_acc = _single_track_error(d)
    assert ax < 0.015
    assert ay < 0.015
    assert motion < 0.03
    assert yaw_acc < 0.005


@pytest.mark.parametrize("name", SWITCHES)
def test_each_effect_shows_and_leaves_the_car_drivable(plain: Drive, name: str) -> None:
    effect = _drive({name: SWITCHES[name].example})
    assert effect.columns["t"][-1] > 23.9
    assert effect.off_track == 0
    before, after = _single_track_error(plain), _single_track_error(effect)
    weak = {"load_transfer": 1.005, "engine_braking": 1.005, "combined_slip": 1.005, "drive_saturation": 1.002}
    gain = max(a / b for a, b in zip(after, before, strict=True))
    assert gain > weak.get(name, 1.02), f"{name}: {before} -> {after}"


def test_one_seed_gives_one_log() -> None:
    first, again, other = (_drive(seed=seed, seconds=6.0) for seed in (3, 3, 4))
    assert all(np.array_equal(first.columns[name], again.columns[name]) for name in first.columns)
    assert not np.array_equal(first.columns["ax"], other.columns["ax"])


def test_unknown_effect_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"effect 'aero_dragg' is unknown; known: aero_drag, rolling_resistance"):
        configure(effects={"aero_dragg": 1.0})


def test_size_out_of_range_names_range_and_unit() -> None:
    with pytest.raises(InputError, match=r"effect steer_offset = 0.5 is outside -0.05 to 0.05 rad"):
        configure(effects={"steer_offset": 0.5})


@pytest.mark.parametrize("text", ["aero_drag", "aero_drag=", "aero_drag=much"])
def test_malformed_effect_shows_the_form(text: str) -> None:
    with pytest.raises(InputError, match="write NAME=SIZE"):
        parse_effects([text])


def test_realistic_base_has_what_the_paper_leaves_out() -> None:
    realistic = drive(base="av24", seconds=36.0, start_s=1850.0, levels=(0.75, 0.75))
    ax, ay, motion, _ = _single_track_error(realistic)
    assert realistic.off_track == 0
    assert ax > 0.3
    assert ay > 0.5
    assert motion > 0.2


def test_table_of_effects_is_one_json_object() -> None:
    result = CliRunner().invoke(app, ["effects", "--json"])
    assert result.exit_code == 0
    table = json.loads(result.stdout)
    assert set(table) == set(SWITCHES)
    assert table["steer_offset"] == {
        "unit": "rad",
        "meaning": "true minus reported road-wheel angle",
        "range": [-0.05, 0.05],
    }


def test_examples_lie_within_their_range() -> None:
    assert all(s.low <= s.example <= s.high for s in SWITCHES.values())


def test_an_effect_without_a_carrier_brings_it_on_the_paper_base_only() -> None:
    assert configure("paper", {"wind": 5.0}).car.drag == AV24.car.drag
    assert configure("paper", {"wind": 5.0, "aero_drag": 0.9}).car.drag == 0.9
    assert configure("av24", {"aero_drag": 0.0, "wind": 5.0}).car.drag == 0.0
    assert configure("paper", {"load_sensitivity": 0.2}).car.downforce > 0
