"""Numbers of a car that the filters are given with every period: nothing is compiled anew for another one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca

from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.observer.bank import GATE
from hil_gateway.process.arrays import Array, Expr


class Sensing(NamedTuple):
    """Standard deviations that the folder states of the first inertial sensor, and of a wheel's speed, SI."""

    turn: Expr
    ahead: Expr
    rate: Expr
    force: Expr
    wheel: Expr


YIELDS = 0.03
"""slip of slicks over the share of their load that they push or brake with: C_x is 25 to 50 times the load"""
SLIP_S = 0.3
"""time constant of slip beyond that: brakes and throttle move as fast"""
GRAVITY_S = 5.0
"""that of gravity that the map lacks: 300 m of road"""
BODY = 0.49
"""m/s2 a sample: pitch and roll of the body behind the filter of an accelerometer (0.05 s)"""
VIBRATION = 0.0036
"""rad/s a sample of a gyro: engine and road"""
SLOW_S = 600.0
"""s in which what is slow about a car (tyres, pads, offsets) moves by as much as it differed at first"""


def numbers_of(car: Car, slow: Array) -> list[float]:
    """Of `Vehicle`, of `Sensing`, friction lost with load, and variances a second of slow states whose first deviations
    are `slow`."""
    name, imu = next(iter(car.imus.items()))
    noise = imu.rate_noise, imu.acceleration_noise, car.sensors.wheel_speed_noise
    mounting = car.std(f"imu.{name}.yaw"), car.std(f"imu.{name}.x")
    return [*car.vehicle.model_dump().values(), *mounting, *noise, car.tyres.load_sensitivity, *(slow**2 / SLOW_S)]


def sound_imu_within(car: Car) -> tuple[float, float]:
    """By how much a rate (rad/s) and a specific force (m/s2) that the first inertial sensor reads differ at most from
    what the car does, by its own noise and by what shakes it."""
    imu = next(iter(car.imus.values()))
    return GATE * math.hypot(imu.rate_noise, VIBRATION), GATE * math.hypot(imu.acceleration_noise, BODY)


class Given(NamedTuple):
    """The same as symbols, after those of a period."""

    all: Expr
    period: list[Any]
    vehicle: Vehicle
    sensing: Sensing
    fades: Any
    """friction that a tyre loses when its load doubles"""
    slow: list[Any]


def given(reported: int, slow: int) -> Given:
    """`reported`: numbers of a period; `slow`: of states."""
    names = list(Vehicle.model_fields)
    counts = [reported, len(names), len(Sensing._fields), 1, slow]
    vector = ca.SX.sym("given", sum(counts))
    symbols: Iterator[Any] = iter(ca.vertsplit(vector))
    period, car, sensing, (fades,), walks = ([next(symbols) for _ in range(count)] for count in counts)
    vehicle = Vehicle.model_construct(**dict(zip(names, car, strict=True)))
    return Given(vector, period, vehicle, Sensing(*sensing), fades, walks)
