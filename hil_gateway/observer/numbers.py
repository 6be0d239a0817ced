"""Numbers of a car that the filters are given with every period: nothing is compiled anew for another one."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr


class Sensing(NamedTuple):
    """Standard deviations that the folder states of the first inertial sensor, and of a wheel's speed, SI."""

    turn: Expr
    ahead: Expr
    rate: Expr
    force: Expr
    wheel: Expr


def numbers_of(car: Car) -> list[float]:
    """Of `Vehicle`, then of `Sensing`."""
    name, imu = next(iter(car.imus.items()))
    noise = imu.rate_noise, imu.acceleration_noise, car.sensors.wheel_speed_noise
    return [*car.vehicle.model_dump().values(), car.std(f"imu.{name}.yaw"), car.std(f"imu.{name}.x"), *noise]


class Given(NamedTuple):
    """The same as symbols, after those of a period."""

    all: Expr
    period: list[Any]
    vehicle: Vehicle
    sensing: Sensing


def given(reported: int) -> Given:
    """`reported`: numbers of a period."""
    names = list(Vehicle.model_fields)
    vector = ca.SX.sym("given", reported + len(names) + len(Sensing._fields))
    symbols: list[Any] = list(ca.vertsplit(vector))
    car, sensing = symbols[reported : reported + len(names)], symbols[reported + len(names) :]
    vehicle = Vehicle.model_construct(**dict(zip(names, car, strict=True)))
    return Given(vector, symbols[:reported], vehicle, Sensing(*sensing))
