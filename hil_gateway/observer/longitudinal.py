"""Gain and loss of speed: what engine and brakes are declared to make, what the wheels show, and what the IMU feels.

    dv/dt = a_x - gravity along    a_x = k_e engine - k_b brakes - drag v^2 + e

with gains k of engine and brakes, and e what both are wrong by at the moment. Wheels show v + w: w of their slip, as
engine or brakes act.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.observer.bank import FILTERS, GATE, Bank
from hil_gateway.observer.kalman_step import Known, step_function
from hil_gateway.observer.numbers import BODY, GRAVITY_S, SLIP_S, YIELDS, Given, given, numbers_of
from hil_gateway.process.arrays import Array, Expr
from hil_gateway.process.compiled import CompiledFunction

STATES = ("speed", "force_error", "slip", "gravity_error", "engine", "brakes", "force_offset")
"""v m/s, e m/s2, w m/s, gravity along that the map lacks m/s2; k_e, k_b, offset of the accelerometer m/s2"""
V, E, W, GB, ENGINE, BRAKES, OFFSET = range(len(STATES))
FAST = GB + 1


class LongitudinalPeriod(NamedTuple):
    """What is reported in one period, SI."""

    dt: float
    braking: float
    """m/s2 by both brakes, as declared for their pressures"""
    pushing: float
    """m/s2 by the engine, as declared"""
    changed: float
    """m/s2 by which both together have changed in the time in which they act"""
    wheels: float
    """speed by the wheels, m/s"""
    ax: float


@dataclass(frozen=True)
class LongitudinalNoise:
    """What the model is wrong by, as standard deviations; beyond what the car folder states. SI."""

    force: float = 0.4
    """m/s2: engine drag, shifts, wind, kerbs"""
    force_share: float = 0.08
    """of the force asked for: pads, heat, the engine's map"""
    force_s: float = 0.3
    """time constant of both"""
    slip: float = 0.1
    """m/s of wheels that roll"""
    gravity: float = 0.5
    """m/s2: grades of 5 % that the map lacks; side slip of 1 m/s at 0.5 rad/s"""
    wheels: float = 0.096
    """m/s a sample: tread, the turn of the car"""


NOISE = LongitudinalNoise()
TIMES = {E: NOISE.force_s, W: SLIP_S, GB: GRAVITY_S}


def prior(car: Car) -> tuple[Array, Array]:
    """Mean and standard deviation of `STATES` before the car has driven; (7,) each."""
    train, imu = car.powertrain, next(iter(car.imus))
    brakes = car.std("powertrain.brake_force_per_pa") / train.brake_force_per_pa
    mean = [0.0] * FAST + [1.0, 1.0, 0.0]
    std = [
        car.actuators.speed_max, NOISE.force, NOISE.slip, NOISE.gravity,
        brakes, brakes, car.std(f"imu.{imu}.acceleration_offset"),
    ]  # fmt: skip
    return np.array(mean), np.array(std)


class Speeding:
    """The model of one period; see `kalman_step.StepModel`."""

    states = len(STATES)
    judged = 1

    def __init__(self, given: Given, period: LongitudinalPeriod) -> None:
        self.u, self._sensing, self._slow, self._car = period, given.sensing, given.slow, given.vehicle

    def after(self, x: Expr, known: Known) -> Expr:
        """States one period on."""
        states = _entries(x)
        states[V] += self.u.dt * (self._force(x) - x[GB])
        for i, time_s in TIMES.items():
            states[i] *= ca.exp(-self.u.dt / time_s)
        return ca.vertcat(*states)

    def noise(self, x: Expr, known: Known) -> Expr:
        """Variances that the period adds; a force that changes acts some tenths of a second later, or not yet."""
        u, n = self.u, NOISE
        asked = u.braking + u.pushing
        force = n.force + n.force_share * asked + 0.5 * u.changed
        deviations = force, n.slip + x[V] * slipped(asked, self._car.pressed(x[V])), n.gravity
        added = [d**2 * (1.0 - ca.exp(-2.0 * u.dt / TIMES[i])) for i, d in zip(TIMES, deviations, strict=True)]
        return ca.vertcat(0.0, *added, *(u.dt * walk for walk in self._slow))

    def shown(self, x: Expr, known: Known) -> tuple[Expr, ...]:
        """Wheels, accelerometer."""
        return x[V] + x[W], self._force(x) + x[OFFSET]

    def measured(self) -> tuple[Expr, ...]:
        """The same as reported."""
        return self.u.wheels, self.u.ax

    def variances(self, x: Expr, known: Known) -> tuple[Expr, ...]:
        """Of one sample."""
        return NOISE.wheels**2 + self._sensing.wheel**2, BODY**2 + self._sensing.force**2

    def _force(self, x: Expr) -> Expr:
        """a_x, m/s2."""
        return x[ENGINE] * self.u.pushing - x[BRAKES] * self.u.braking - self._car.drag(x[V]) + x[E]


def slipped(asked: Any, pressed: Any) -> Any:
    """By which wheels slip, of their speed, that push or brake by `asked`, pressed down by `pressed`, m/s2; numbers or
    symbols."""
    return YIELDS * asked / pressed


def longitudinal_bank(car: Car) -> Bank:
    """Filters of `Speeding`."""
    mean, std = prior(car)
    return Bank(_function().twin(), numbers_of(car, std[FAST:]), (mean, std), FAST, Speeding.judged)


@cache
def _function() -> CompiledFunction:
    """For all cars: their numbers are given with the period."""
    g = given(len(LongitudinalPeriod._fields), len(STATES) - FAST)
    return step_function("longitudinal", Speeding(g, LongitudinalPeriod(*g.period)), g.all, GATE, FILTERS)


def _entries(vector: Expr) -> list[Any]:
    return list(ca.vertsplit(vector))
