"""Vehicle and tyre prior from JSON files, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from estimator.model.parameters import LAYOUTS, Layout, layout_of, tyre_limits, tyre_prior
from estimator.model.tyre import AXLES, front_and_rear
from estimator.offline.tyre_file import read_tyre_file
from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import first_mistake
from hil_gateway.text_file import read_json

GYRATION = (0.1, 1.5)
"""radius of gyration about the vertical over the wheelbase, of cars of any size: 0.4 of a race car, about half of most;
a slip of a digit in mass, yaw inertia or an axle's place lies outside"""


TYRE_PROPERTIES = ".tir"
LENGTHS = ("cg_height", "track_front", "track_rear", "half_width", "wheel_radius")
AREAS = ("drag_area", "lift_area_front", "lift_area_rear")


def read_vehicle(path: Path | None, car: Car) -> Vehicle:
    """Vehicle data; those of `car` where no file is given, and in proportion to its wheelbase what a file leaves out.

    Raises:
        InputError: unreadable file, unknown key, missing or impossible value.
    """
    if path is None:
        return car.vehicle
    data = _read_object(path)
    for key in ("mass", "yaw_inertia", "lf", "lr"):
        if key not in data:
            raise InputError(f"{path}: {key} is missing: mass, yaw_inertia, lf and lr are needed")
    try:
        given = Vehicle.model_validate({**car.vehicle.model_dump(), **data}, strict=True)
        vehicle = _in_proportion(given, data.keys(), car.vehicle)
    except ValidationError as error:
        raise InputError(f"{path}: {first_mistake(error)}") from None
    low, high = GYRATION
    if not low <= (share := math.sqrt(vehicle.yaw_inertia / vehicle.mass) / vehicle.wheelbase) <= high:
        raise InputError(
            f"{path}: mass = {vehicle.mass:g} kg, yaw_inertia = {vehicle.yaw_inertia:g} kg m2 and lf + lr ="
            f" {vehicle.wheelbase:g} m cannot be of one car: its radius of gyration is {share:.2g} wheelbases,"
            f" a car has {low:g} to {high:g}; are the units SI?"
        )
    return vehicle


def _in_proportion(vehicle: Vehicle, stated: Set[str], car: Vehicle) -> Vehicle:
    """`vehicle` with the lengths and areas that are not `stated` as `car` has them, at its own size."""
    size = vehicle.wheelbase / car.wheelbase
    scaled = {**dict.fromkeys(LENGTHS, size), **dict.fromkeys(AREAS, size**2)}
    left_out = scaled.keys() - stated
    return vehicle.model_copy(update={name: scaled[name] * getattr(car, name) for name in left_out})


def default_tyre_prior(layout: Layout, vehicle: Vehicle, car: Car) -> Mapping[str, float]:
    """The tyres of `car`, with C_x in proportion to the weight they carry: B, C and D have no such scale."""
    values = tyre_prior(car, layout)
    return {**values, "cx": values["cx"] * vehicle.mass / car.vehicle.mass}


def read_tyre_prior(path: Path | None, layout: Layout, vehicle: Vehicle, car: Car) -> Mapping[str, float]:
    """Tyre prior of `layout`; one given for the other layout is converted (axle means, or both axles alike).

    Without a file it is `default_tyre_prior`.

    Raises:
        InputError: unreadable file, unknown key, missing, non-numeric or not positive value.
    """
    if path is None:
        return default_tyre_prior(layout, vehicle, car)
    data = _read_tyre(path, vehicle, car)
    given = layout_of(data)
    names = LAYOUTS[given]
    if unknown := sorted(set(data) - set(names)):
        raise InputError(f"{path}: unknown key {unknown[0]}: a tyre prior holds {', '.join(names)}")
    for name in names:
        value = data.get(name)
        if value is None:
            raise InputError(f"{path}: {name} is missing: a tyre prior holds {', '.join(names)}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
            raise InputError(f"{path}: {name} = {value!r} must be a positive number")
        low, high = tyre_limits(name)
        if not low < value < high:
            raise InputError(f"{path}: {name} = {value:g}: a tyre has {low:g} to {high:g}")
    return in_layout({name: float(data[name]) for name in names}, given, layout)


def _read_tyre(path: Path, vehicle: Vehicle, car: Car) -> dict[str, Any]:
    """Values of a JSON or property file; C_x is the car's where the latter has none."""
    if path.suffix.lower() != TYRE_PROPERTIES:
        return _read_object(path)
    return {"cx": default_tyre_prior("per_axle", vehicle, car)["cx"], **read_tyre_file(path, vehicle)}


def in_layout(values: Mapping[str, float], given: Layout, wanted: Layout) -> Mapping[str, float]:
    """Tyre parameters of one layout in another."""
    if given == wanted:
        return dict(values)
    curves = [axle.of(values) for axle in front_and_rear(given)]
    if wanted == "shared":
        curves = [tuple(0.5 * (front + rear) for front, rear in zip(*curves, strict=True))]
    named = {
        n: v
        for axle, curve in zip(AXLES[wanted], curves, strict=True)
        for n, v in zip(axle.parameters, curve, strict=True)
    }
    return {"cx": values["cx"], **named}


def _read_object(path: Path) -> dict[str, Any]:
    data = read_json(path)
    if not isinstance(data, dict):
        raise InputError(f"{path}: must hold one JSON object")
    return data
