"""Parameter tables: names, units, priors and bounds of the tyre (Table I of the paper) and of any effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Literal

from can_dbc.folder import DEFAULT_PLATFORM
from hil_gateway.car.car import Car, load_car
from hil_gateway.car.vehicle import Vehicle

Layout = Literal["shared", "per_axle"]


@dataclass(frozen=True)
class Plausible:
    """Values of a parameter that an engineer would believe, inside the bounds of a fit, and why.

    Closer than `least` to the neutral value it is no defect: every healthy part does that.
    """

    lower: float
    upper: float
    reason: str
    least: float = 0.0


class Quantity(Enum):
    """What a parameter is of the car, its sensors or the road, for whoever asks for that and not for an effect."""

    BANK = "bank of the road, rad, left side up"
    GRADE = "grade of the road, rad, uphill"
    DOWNFORCE = "downforce on an axle over speed squared, N s2/m2"
    CG_HEIGHT = "effective height of the centre of gravity, m"
    FRICTION_ELLIPSE = "lateral over longitudinal friction"
    TRACTION_ELLIPSE = "share of the friction ellipse that lateral force takes from the longitudinal one"
    FRONT_BRAKE_SHARE = "front axle's part of the brakes' force at equal pressures"
    BRAKE_GAIN = "braking over driving force per unit of slip command"
    DRIVE_DELAY = "forces of engine and brakes after they are reported, s"
    STEER_ZERO = "true minus reported road-wheel angle, rad"
    ACCELEROMETER_AHEAD = "accelerometer ahead of the centre of gravity, m"
    LATERAL_ZERO = "zero of the lateral accelerometer, m/s2"
    GYROSCOPE_ZERO = "zero of the yaw-rate gyroscope, rad/s"
    GYROSCOPE_GAIN = "reported over true yaw rate"
    SPEED_SCALE = "reported over true forward speed"


SLOPES = (Quantity.BANK, Quantity.GRADE)
"""of the road, across and along the car"""


@dataclass(frozen=True)
class Parameter:
    """One scalar to be learnt. `prior_std` also scales it inside every solver and inside Tr(F) (Eq. 7).

    A fit may go to `lower` and `upper`; what it finds outside `plausible` is no finding. `tells`: whether its being off
    the neutral value is a sign of its effect; what only goes along with it is none, as the scale of the brakes beside
    their split.
    """

    name: str
    unit: str
    prior: float
    prior_std: float
    lower: float
    upper: float
    description: str
    plausible: Plausible | None = None
    tells: bool = True
    quantity: Quantity | None = None


_DIMENSIONS: Mapping[str, tuple[float, float]] = {
    "N": (1.0, 0.0), "N s2/m2": (1.0, -1.0), "N m s/rad": (1.0, 1.5), "rad/(kN m2)": (-1.0, -2.0), "m": (0.0, 1.0),
}  # fmt: skip
"""unit -> exponents of mass and wheelbase of what cars of all sizes have alike where gravity is the same (Froude's
similarity). Others do not grow with the car: ratios, angles, specific forces, and what sensors, actuators and the air
have of their own."""


def table_car() -> Vehicle:
    """The car that the ranges of all effects are written down for."""
    return load_car(DEFAULT_PLATFORM).vehicle


def of_size(parameter: Parameter, vehicle: Vehicle) -> Parameter:
    """`parameter` with its range in proportion to the mass and the wheelbase of `vehicle`."""
    by_mass, by_length = _DIMENSIONS.get(parameter.unit, (0.0, 0.0))
    table = table_car()
    k = (vehicle.mass / table.mass) ** by_mass * (vehicle.wheelbase / table.wheelbase) ** by_length
    p, believed = parameter, parameter.plausible
    if believed is not None:
        believed = replace(believed, lower=k * believed.lower, upper=k * believed.upper, least=k * believed.least)
    return replace(
        p, prior=k * p.prior, prior_std=k * p.prior_std, lower=k * p.lower, upper=k * p.upper, plausible=believed
    )


LAYOUTS: Mapping[Layout, tuple[str, ...]] = {
    "shared": ("cx", "b", "c", "d"),
    "per_axle": ("cx", "bf", "cf", "df", "br", "cr", "dr"),
}
"""layout -> its tyre parameters, in the order of theta"""


def tyre_prior(car: Car, layout: Layout) -> dict[str, float]:
    """What is declared of the tyres of a car, in the order of theta."""
    return {name: getattr(car.tyres, name) for name in LAYOUTS[layout]}


_Kind = tuple[str, float, tuple[float, float], tuple[float, float], str]
# kind -> (unit, prior std over prior, lower and upper over prior, absolute bounds, description)
_KINDS: Mapping[str, _Kind] = {
    "cx": ("N", 0.5, (0.01, 20.0), (0.0, 1e7), "longitudinal force per unit slip ratio"),
    "b": ("1", 0.5, (0.05, 8.0), (0.0, 80.0), "stiffness factor of Eq. (2)"),
    "c": ("1", 0.4, (0.3, 2.5), (0.5, 2.0), "shape factor of Eq. (2); above 2 a sliding tyre would push the wrong way"),
    "d": ("1", 0.4, (0.2, 3.0), (0.05, 4.0), "peak lateral force over axle load"),
}


STIFFNESS = (4.0, 60.0)
"""B C D of any tyre, 1/rad: from a soft road tyre far beyond its load to a race tyre at a small one"""


def tyre_limits(name: str) -> tuple[float, float]:
    """What a tyre parameter is always within, whatever its prior."""
    return _kind(name)[3]


def _kind(name: str) -> _Kind:
    return _KINDS["cx" if name == "cx" else name[0]]


def _tyre_parameter(name: str, value: float) -> Parameter:
    unit, spread, (low, high), (floor, ceiling), text = _kind(name)
    axle = {"f": ", front axle", "r": ", rear axle"}.get(name[1:], "")
    return Parameter(
        name, unit, value, spread * value, max(low * value, floor), min(high * value, ceiling), text + axle
    )


def tyre_parameters(prior: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Tyre parameter table around `prior`, in the order of theta.

    Raises:
        ValueError: a parameter is missing, unknown or not positive.
    """
    layout = layout_of(prior)
    names = LAYOUTS[layout]
    if set(prior) != set(names):
        raise ValueError(f"tyre parameters {sorted(prior)} do not fit layout {layout}: expected {sorted(names)}")
    if bad := [n for n in names if not prior[n] > 0]:
        raise ValueError(f"tyre parameter {bad[0]} = {prior[bad[0]]} must be positive")
    return tuple(_tyre_parameter(n, prior[n]) for n in names)


def layout_of(values: Mapping[str, float]) -> Layout:
    """Layout that a set of parameter names belongs to."""
    return "shared" if "b" in values else "per_axle"
