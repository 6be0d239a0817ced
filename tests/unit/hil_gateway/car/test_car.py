"""The car's numbers: read with unit, deviation and source, or refused by name."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from can_dbc.folder import SHIPPED
from hil_gateway.car.car import load_car
from hil_gateway.car.tyre_names import label
from hil_gateway.process.errors import InputError


def test_numbers_are_converted_to_the_units_of_the_project() -> None:
    car = load_car("av24")
    assert car.powertrain.brake_pressure_max == pytest.approx(6.0e6), "given in kPa"
    assert car.powertrain.force_per_drive == pytest.approx(50_000.0), "given in kN"
    assert car.actuators.steering_rate == pytest.approx(8.7266, abs=1e-4), "given in deg/s"
    assert car.imus["main"].acceleration_noise == pytest.approx(0.0980665), "given in g"
    assert car.receivers["mylaps"].wander_time == pytest.approx(600.0), "given in min"
    assert car.powertrain.upshift_rpm == 6500, "kept in rpm"


@pytest.mark.parametrize("name", sorted(folder.name for folder in SHIPPED.iterdir() if (folder / "car.toml").exists()))
def test_every_shipped_car_is_read(name: str) -> None:
    car = load_car(name)
    assert car.imus and car.receivers


def test_how_well_a_number_is_known_goes_with_it() -> None:
    car = load_car("av24")
    assert car.std("vehicle.cg_height") == pytest.approx(0.15 * 0.275), "given in %"
    assert car.std("vehicle.lf") == pytest.approx(0.05), "given in m"
    assert car.std("powertrain.gears") == 0.0, "exact"
    assert "public" in car.figures["vehicle.mass"].source


def test_sensors_come_in_the_order_of_the_signals() -> None:
    assert list(load_car("av24").receivers) == ["novatel", "marelli", "mylaps"]


MASS = 'mass = { value = 787.3, unit = "kg", std = "3 %", source'


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (MASS, 'mass = { value = 787.3, unit = "km", std = "3 %", source', "unit 'km': it is given in kg, lb"),
        (MASS, 'mass = { value = 787.3, unit = "kg", source', "vehicle.mass.std is missing"),
        (MASS, 'mass = { value = 787.3, unit = "kg", std = "some", source', 'vehicle.mass.std.*"10 %", or "exact"'),
        (MASS, 'mass = { value = -1, unit = "kg", std = "3 %", source', "vehicle.mass = -1.0"),
        (MASS, 'mass = { value = 78.7, unit = "kg", std = "3 %", source', "vehicle.mass = 78.7: a race car has 200 to"),
        (MASS, 'mass = { value = "x", unit = "kg", std = "3 %", source', "vehicle.mass.value"),
        (MASS, 'mas = { value = 787.3, unit = "kg", std = "3 %", source', "unknown key vehicle.mas; known are mass"),
        ("[vehicle]", "[vehicel]", "unknown key vehicel; known are name, vehicle"),
        ("[imu.main]", "[imu.second]", "imu.second.* is not in signals.toml"),
        ('name = "Dallara AV-24"', "", "name is missing"),
        ("brake_bias_front = { value = 0.54", "brake_bias_front = { value = 0.99", "brake_bias_front = 0.99"),
        ("upshift_rpm = { value = 6500", "upshift_rpm = { value = 5000", "clutch_rpm < downshift_rpm < upshift_rpm"),
        ("[tyres]", "[tyres", "not valid TOML"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_numbers_is_named(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    folder = tmp_path / "car"
    shutil.copytree(SHIPPED / "av24", folder)
    text = (folder / "car.toml").read_text()
    assert old in text
    (folder / "car.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=complaint) as caught:
        load_car(str(folder))
    assert str(caught.value).startswith(f"{folder}/car.toml: ")


def test_where_the_lateness_of_the_wheels_is_not_given_it_is_as_unknown_as_the_steering_is_late(tmp_path: Path) -> None:
    folder = tmp_path / "car"
    shutil.copytree(SHIPPED / "av24", folder)
    lines = (folder / "car.toml").read_text().splitlines(keepends=True)
    (folder / "car.toml").write_text("".join(line for line in lines if not line.startswith("angle_delay")))
    car = load_car(str(folder))
    assert car.actuators.angle_delay == 0.0
    assert car.std("actuators.angle_delay") == car.actuators.steering_delay == 0.04


def test_a_parameter_without_a_name_is_called_by_its_symbol_once():
    assert label("cx") == "drive stiffness C_x (cx), N"
    assert label("steer_timing.tau") == "steer timing.tau"
