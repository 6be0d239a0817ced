"""Turning of the car: single-track model with tyres that saturate, and what each sensor says of it.

With the slip angles of both axles (l_f, l_r from the centre of gravity, speed v, side slip v_y, yaw rate r, steering
angle delta with its zero delta_0)

    alpha_f = delta + delta_0 - (v_y + l_f r) / v        alpha_r = -(v_y - l_r r) / v

an axle makes the specific force (of the whole car, were the other axle like it)

    a_i = mu_i g_i (sqrt(1 - (kappa b_i / (mu_i g_i))^2) tanh(alpha_i / s_i) + e_i)

with g_i the axle's load by gravity, downforce, engine and brakes over the mass that it carries at rest, less what tyres
grip less with load, b_i what engine and brakes ask of it, of which the front axle takes a share beta more than
declared, kappa the ellipse of friction, of two wheels that carry unlike, and e_i what the model is wrong by, correlated
in time. For tanh and root stands the line that fits them best where slip angle and balance may be, and what it leaves
of them is noise (statistical linearisation: A. Gelb, Applied Optimal Estimation, 1974, ch. 6): a tangent is too sure of
a car that slides. From there

    dv_y/dt = a_y - v r - gravity across    dr/dt = m l_f l_r / (L I_z) (a_f - a_r)    a_y = (l_r a_f + l_f a_r) / L

Wheels of an axle show r + v m + w: m of unequal rolling radii, w of unequal slip where engine or brakes act, the more
the less grip the force across leaves (friction circle).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.observer.bank import FILTERS, GATE, Bank
from hil_gateway.observer.kalman_step import Known, step_function
from hil_gateway.observer.numbers import BODY, GRAVITY_S, SLIP_S, VIBRATION, YIELDS, Given, given, numbers_of
from hil_gateway.process.arrays import Array, Expr
from hil_gateway.process.compiled import CompiledFunction

STATES = (
    "side_speed", "yaw_rate", "front_error", "rear_error", "front_slip", "rear_slip", "gravity_error",
    "steer_zero", "steer_delay", "front_slope", "rear_slope", "front_grip", "rear_grip", "ellipse", "brake_share",
    "height", "gyro_offset", "force_offset", "front_radii", "rear_radii",
)  # fmt: skip
"""v_y m/s, r rad/s, e_f, e_r, w_f, w_r rad/s, gravity across that the map lacks m/s2; then what is slow about the car:
delta_0 rad, tau s, s_f, s_r rad, mu_f, mu_r, kappa, beta, height of the centre of gravity m, offsets of gyro rad/s and
accelerometer m/s2, m_f, m_r 1/m"""
(
    VY, R, EF, ER, WF, WR, GB,
    ZERO, DELAY, SF, SR, MUF, MUR, ELLIPSE, SHARE, H, GYRO, FORCE, MF, MR,
) = range(len(STATES))  # fmt: skip
FAST = GB + 1
"""so many states are forgotten while the car stands"""


class LateralPeriod(NamedTuple):
    """What is reported in one period, SI."""

    dt: float
    speed: float
    steer: float
    """road-wheel angle"""
    steer_rate: float
    """its mean rate over the time by which the road wheels may be late"""
    braked_front: float
    """m/s2 by the brakes of an axle, as declared for their pressure"""
    braked_rear: float
    pushing: float
    """m/s2 by the engine, as declared"""
    gravity_across: float
    """g sin(bank) of the map, m/s2"""
    front: float
    """(right - left) over the track"""
    rear: float
    yaw_rate: float
    ay: float
    steers: float
    """1 where the car steers as reported, 0 where that is not known: only its wheels tell then"""


@dataclass(frozen=True)
class LateralNoise:
    """What the model is wrong by, as standard deviations; beyond what the car folder states. SI."""

    force: float = 0.05
    """of a tyre's force: load transfer across, camber, road"""
    force_s: float = 0.5
    """its time constant: a bend takes longer, a bump less"""
    slip: float = 0.01
    """rad/s between the wheels of an axle that rolls"""
    slip_share: float = 0.5
    """of the slip by which wheels carry engine and brakes: the inner one carries less"""
    slip_at_limit: float = 1.0
    """of the speed of a wheel: under brakes that take all of the grip it locks, and says nothing"""
    wheels: float = 0.025
    """rad/s a sample of an axle: tread"""
    yaw_walk: float = 0.05
    """rad/s, per square root of a second: gusts, kerbs"""
    yaw_walk_unknown: float = 1.0
    """the same of a car that does not steer as it reports: 3 rad/s2 for a tenth of a second"""
    gravity: float = 0.7
    """m/s2: banks of 4 deg that the map smooths or lacks"""
    slide: float = 0.15
    """rad of rear slip angle that a car is driven with at most; half of it moves the steering zero in long bends"""
    slide_s: float = 1.0
    """so long"""
    least_left: float = 0.3
    """of the grip that a tyre has left one way where all of it seems to be used the other way"""
    brake_share: float = 0.1
    """share of the brakes' force that acts in front beyond the declared one: worn or glazed pads, air in a circuit"""


NOISE = LateralNoise()
TIMES = {EF: NOISE.force_s, ER: NOISE.force_s, WF: SLIP_S, WR: SLIP_S, GB: GRAVITY_S}
"""time constants of what is correlated in time, s"""


def prior(car: Car) -> tuple[Array, Array]:
    """Mean and standard deviation of `STATES` before the car has driven, by the numbers of its folder; (20,) each."""
    tyres, vehicle, imu = car.tyres, car.vehicle, next(iter(car.imus))
    slopes = [1.0 / (tyres.bf * tyres.cf), 1.0 / (tyres.br * tyres.cr)]
    spread = [
        np.hypot(car.std(f"tyres.b{axle}") / b, car.std(f"tyres.c{axle}") / c)
        for axle, b, c in (("f", tyres.bf, tyres.cf), ("r", tyres.br, tyres.cr))
    ]
    unequal = np.sqrt(2.0) * car.std("vehicle.wheel_radius") / vehicle.wheel_radius
    mean = [
        *[0.0] * FAST, 0.0, car.actuators.angle_delay, *slopes, tyres.df, tyres.dr, tyres.combined_slip, 0.0,
        vehicle.cg_height, *[0.0] * 4,
    ]  # fmt: skip
    std = [
        0.5, 0.1, NOISE.force, NOISE.force, NOISE.slip, NOISE.slip, NOISE.gravity,
        car.std("sensors.steering_offset") / vehicle.steering_ratio, car.std("actuators.angle_delay"),
        slopes[0] * spread[0], slopes[1] * spread[1], car.std("tyres.df"), car.std("tyres.dr"),
        car.std("tyres.combined_slip"), NOISE.brake_share, car.std("vehicle.cg_height"),
        car.std(f"imu.{imu}.rate_offset"), car.std(f"imu.{imu}.acceleration_offset"),
        unequal / vehicle.track_front, unequal / vehicle.track_rear,
    ]  # fmt: skip
    return np.array(mean), np.array(std)


class Turning:
    """The model of one period; see `kalman_step.StepModel`."""

    states = len(STATES)
    judged = 2

    def __init__(self, given: Given, period: LateralPeriod) -> None:
        self.car, self.u, self._sensing, self._slow = given.vehicle, period, given.sensing, given.slow
        self._fades = given.fades
        self._braking = period.braked_front + period.braked_rear
        self._pressed = self.car.axles_pressed(period.speed)

    def after(self, x: Expr, known: Known) -> Expr:
        """States one period on."""
        u, states = self.u, _entries(x)
        states[VY] += u.dt * (self._force(x, known) - u.speed * x[R] - u.gravity_across - x[GB])
        states[R] += u.dt * self._turning(x, known)
        for i, time_s in TIMES.items():
            states[i] *= ca.exp(-u.dt / time_s)
        return ca.vertcat(*states)

    def noise(self, x: Expr, known: Known) -> Expr:
        """Variances that the period adds."""
        u, n, slipping = self.u, NOISE, self._slipping(x)
        errors = [n.force * ca.fabs(share.at) + share.rest for share in self._shares(x, known)]
        coloured = {EF: errors[0], ER: errors[1], WF: slipping[0], WR: slipping[1], GB: n.gravity}
        added = [d**2 * (1.0 - ca.exp(-2.0 * u.dt / TIMES[i])) for i, d in coloured.items()]
        turning = u.steers * n.yaw_walk**2 + (1.0 - u.steers) * n.yaw_walk_unknown**2
        return ca.vertcat(0.0, turning * u.dt, *added, *(u.dt * walk for walk in self._slow))

    def shown(self, x: Expr, known: Known) -> tuple[Expr, ...]:
        """Both axles' wheels, side slip of the rear axle, gyro, accelerometer."""
        speed = self.u.speed
        slide = (x[VY] - self.car.lr * x[R]) / speed
        wheels = x[R] + x[WF] + speed * x[MF], x[R] + x[WR] + speed * x[MR]
        return *wheels, slide, x[R] + x[GYRO], self._force(x, known) + x[FORCE]

    def measured(self) -> tuple[Expr, ...]:
        """The same as reported; no car is driven sideways for long."""
        return self.u.front, self.u.rear, ca.SX(0.0), self.u.yaw_rate, self.u.ay

    def variances(self, x: Expr, known: Known) -> tuple[Expr, ...]:
        """An IMU that is turned or ahead of its place feels other forces, too."""
        n, s = NOISE, self._sensing
        wheels = [n.wheels**2 + 2.0 * (s.wheel / track) ** 2 for track in (self.car.track_front, self.car.track_rear)]
        along = self._braking + self.u.pushing
        ay = BODY**2 + s.force**2 + (s.turn * along) ** 2 + (s.ahead * self._turning(x, known)) ** 2
        return *wheels, n.slide**2 * n.slide_s / self.u.dt, VIBRATION**2 + s.rate**2, ay

    def _angles(self, x: Expr) -> tuple[Expr, Expr]:
        """Slip angles of both axles over those that tell how stiff their tyres are."""
        car, u = self.car, self.u
        front = u.steer - u.steer_rate * x[DELAY] + x[ZERO] - (x[VY] + car.lf * x[R]) / u.speed
        rear = -(x[VY] - car.lr * x[R]) / u.speed
        return front / x[SF], rear / x[SR]

    def _shares(self, x: Expr, known: Known) -> list[Line]:
        """Shares of the grip of both axles that turn the car."""
        across = [fitted(ca.tanh, angle, x, known) for angle in self._angles(x)]
        kept = [
            fitted(partial(left_of_both, lean), used, x, known)
            for used, lean in zip(self.used(x), self.leans(x), strict=True)
        ]
        return [one.times(other) for one, other in zip(across, kept, strict=True)]

    def _along(self, x: Expr) -> tuple[Expr, Expr]:
        """What brakes ask of both axles, and engine of the rear one, m/s2 of the whole car were the other axle like it;
        backwards."""
        car, u, moved = self.car, self.u, x[SHARE] * self._braking
        front, rear = u.braked_front + moved, u.braked_rear - moved - u.pushing
        return front * car.wheelbase / car.lr, rear * car.wheelbase / car.lf

    def _loads(self, x: Expr) -> tuple[Expr, Expr]:
        """Of both axles over the mass that they carry at rest, m/s2; wheels that lift brake no more."""
        car, (front, rear), shifted = self.car, self._pressed, x[H] * (self._braking - self.u.pushing)
        least = NOISE.least_left
        return ca.fmax(front + shifted / car.lr, least * front), ca.fmax(rear - shifted / car.lf, least * rear)

    def leans(self, x: Expr) -> list[Expr]:
        """Share of their load that the inner wheels of both axles lose to the outer ones."""
        across, tracks = x[H] * self.u.speed * ca.fabs(x[R]), (self.car.track_front, self.car.track_rear)
        return [2.0 * across / (track * load) for track, load in zip(tracks, self._loads(x), strict=True)]

    def _slipping(self, x: Expr) -> list[Expr]:
        """By which the wheels of both axles slip apart, rad/s."""
        n, car, across = NOISE, self.car, map(ca.tanh, self._angles(x))
        slips = (YIELDS * ca.fabs(a) / load for a, load in zip(self._along(x), self._loads(x), strict=True))
        parts = zip(slips, self.used(x), across, (car.track_front, car.track_rear), strict=True)
        return [
            n.slip + (n.slip_share * slip / left(side) + n.slip_at_limit * used**4) * self.u.speed / track
            for slip, used, side, track in parts
        ]

    def limits(self, x: Expr) -> tuple[Expr, Expr]:
        """Grip of both axles across, m/s2."""
        front, rear = (gripped(load, self._fades) for load in self._loads(x))
        return x[MUF] * front, x[MUR] * rear

    def used(self, x: Expr) -> list[Expr]:
        """Share of the grip along that engine and brakes use of both axles."""
        return [ca.fmin(x[ELLIPSE] * a / limit, 1.0) for a, limit in zip(self._along(x), self.limits(x), strict=True)]

    def _axles(self, x: Expr, known: Known) -> tuple[Expr, Expr]:
        """a_f, a_r, m/s2."""
        (front, rear), limits = self._shares(x, known), self.limits(x)
        return limits[0] * (front.at + x[EF]), limits[1] * (rear.at + x[ER])

    def _force(self, x: Expr, known: Known) -> Expr:
        """a_y, m/s2."""
        front, rear = self._axles(x, known)
        return (self.car.lr * front + self.car.lf * rear) / self.car.wheelbase

    def _turning(self, x: Expr, known: Known) -> Expr:
        """dr/dt, rad/s2."""
        car, (front, rear) = self.car, self._axles(x, known)
        return car.mass * car.lf * car.lr / (car.wheelbase * car.yaw_inertia) * (front - rear)


class Line(NamedTuple):
    """In place of a function that bends."""

    at: Expr
    rest: Expr
    """standard deviation of what it leaves of the function"""

    def times(self, other: Line) -> Line:
        """The product."""
        return Line(self.at * other.at, self.rest * ca.fabs(other.at) + ca.fabs(self.at) * other.rest)


def fitted(function: Callable[[Expr], Expr], of: Expr, x: Expr, known: Known) -> Line:
    """The line that fits a function best where `of` may be: through what it is at the mean and sqrt(3) deviations to
    either side (Gauss and Hermite's rule of three points)."""
    mean = ca.substitute(of, x, known.mean)
    deviation = ca.sqrt(3.0 * known.variance(of, x) + 1e-12)
    low, middle, high = (function(mean + i * deviation) for i in (-1.0, 0.0, 1.0))
    line = (low + 4.0 * middle + high) / 6.0 + (high - low) / (2.0 * deviation) * (of - mean)
    return Line(line, ca.fabs(low - 2.0 * middle + high) / math.sqrt(18.0))


def left_of_both(lean: Expr, used: Expr) -> Expr:
    """The same of an axle whose inner wheel carries less by this share, and brakes as much."""
    outer, inner = 1.0 + lean, ca.fmax(1.0 - lean, 1e-3)
    return (outer * left(used / outer) + inner * left(used / inner)) / (outer + inner)


def gripped(load: Any, fades: Any) -> Any:
    """What of its `load` (m/s2) a tyre grips with that loses friction with load, but never all; numbers or symbols."""
    return load * ca.fmax(1.0 - fades * (load / GRAVITY - 1.0), NOISE.least_left)


def left(used: Expr) -> Expr:
    """Share of the grip that a tyre has left along where it has `used` this share of it across, and the reverse."""
    return ca.sqrt(ca.fmax(1.0 - used**2, NOISE.least_left**2))


def rates_of_wheels(wheels: tuple[float, float, float, float], steer: float, car: Vehicle) -> tuple[float, float]:
    """Yaw rates that front and rear wheels' difference means, rad/s; `wheels` are fl, fr, rl, rr, m/s."""
    fl, fr, rl, rr = wheels
    return (fr - fl) / (car.track_front * math.cos(steer)), (rr - rl) / car.track_rear


def lateral_filters(car: Car) -> tuple[CompiledFunction, list[float], tuple[Array, Array], int, int]:
    """What `Filters` of `Turning` are made of."""
    mean, std = prior(car)
    return _function().twin(), numbers_of(car, std[FAST:]), (mean, std), FAST, Turning.judged


def lateral_bank(car: Car) -> Bank:
    """Filters of `Turning`."""
    return Bank(*lateral_filters(car))


@cache
def _function() -> CompiledFunction:
    """For all cars: their numbers are given with the period."""
    g = given(len(LateralPeriod._fields), len(STATES) - FAST)
    return step_function("lateral", Turning(g, LateralPeriod(*g.period)), g.all, GATE, FILTERS)


def _entries(vector: Expr) -> list[Any]:
    return list(ca.vertsplit(vector))
