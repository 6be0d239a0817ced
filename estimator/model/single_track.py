"""Single-track model, Eq. (1), evaluated stage by stage so that effects can be added without touching it.

The declared model is this file with no effects. An effect hooks into one or more stages and changes the
working set `Terms`; the order of the stages is the order in which the physics acts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.parameters import Layout, Parameter, Quantity, layout_of, tyre_parameters
from estimator.model.tyre import (
    front_and_rear,
    lateral_force,
    load_rows,
    longitudinal_force,
    peak_force,
    slip_front,
    slip_rear,
    with_grip,
)
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr


class Stage(Enum):
    """Where an effect acts, in order of evaluation."""

    INPUT = 1
    """what the car really does against what is reported: steer, drive, speed"""
    SLIP = 2
    LONGITUDINAL = 3
    """longitudinal forces: tyres of both axles and body, N; before the loads, which depend on them"""
    SATURATION = 4
    """what the tyres of each axle make of the longitudinal force asked of them"""
    LOAD = 5
    """axle loads, N"""
    GRIP = 6
    """factors on D"""
    FORCE = 7
    """lateral tyre forces of both axles, N"""
    BODY = 8
    """forces and yaw moment on the body that do not come from the tyres' Eq. (2)"""
    MOTION = 9
    """gravity: moves the car but is not felt by an accelerometer"""
    SENSOR = 10
    """what the sensors make of it"""


SIGNALS = ("vx", "vy", "yaw_rate", "steer", "drive")
"""Arguments every evaluation needs, in order."""

BEFORE_STEP_S = 0.05
DRIVE_BEFORE = tuple(f"drive_before_{k}" for k in range(1, 7))
"""drive command so many steps ago, less the present one: what a delay is worked out from while driving"""

AUXILIARY = (
    "track_position", "t", "yaw", "throttle", "brake", "brake_balance", "gear", "engine_speed", "ax", "steer_rate",
    "drive_rate", "extra_load", "known_bank", *DRIVE_BEFORE,
)  # fmt: skip
"""Further signals an effect may ask for; a caller that has none leaves them out and gets the neutral value 0.

`brake` is a share of full braking, `brake_pressure_max` of the car or pedal 1; `brake_balance` the difference of front
and rear pressure over their sum; `extra_load` is what crests, dips and banks add to the axle loads, over the
weight; `known_bank` is the road's, rad, where it is an input and no effect."""

CHANNELS = ("ax", "ay", "yaw_acc", "vx_dot", "vy_dot")
"""What the model predicts: specific forces as the accelerometer reports them, and the motion."""


@dataclass
class Terms:
    """Working set of one evaluation; every attribute is a CasADi expression.

    `slip_f`, `slip_r` are what a tyre's force follows, `across_f`, `across_r` the share of that force across the wheel;
    `left_f`, `left_r` the share of the lateral force that the longitudinal one leaves;
    `bank` is the road's, rad, left side up positive.
    """

    vehicle: Vehicle
    vx: Expr
    vy: Expr
    yaw_rate: Expr
    steer: Expr
    drive: Expr
    aux: Mapping[str, Expr] = field(default_factory=dict)
    slip_f: Expr = 0.0
    slip_r: Expr = 0.0
    across_f: Expr = 1.0
    across_r: Expr = 1.0
    load_f: Expr = 0.0
    load_r: Expr = 0.0
    grip_f: Expr = 1.0
    grip_r: Expr = 1.0
    fx_f: Expr = 0.0
    fx_r: Expr = 0.0
    peak_f: Expr = 0.0
    peak_r: Expr = 0.0
    fy_f: Expr = 0.0
    fy_r: Expr = 0.0
    left_f: Expr = 1.0
    left_r: Expr = 1.0
    body_x: Expr = 0.0
    body_y: Expr = 0.0
    body_yaw: Expr = 0.0
    bank: Expr = 0.0
    gravity_x: Expr = 0.0
    gravity_y: Expr = 0.0
    ax: Expr = 0.0
    ay: Expr = 0.0
    yaw_acc: Expr = 0.0
    vx_dot: Expr = 0.0
    vy_dot: Expr = 0.0
    imu_ax: Expr = 0.0
    imu_ay: Expr = 0.0

    def auxiliary(self, name: str) -> Expr:
        """Auxiliary signal, or its neutral value 0 where the caller has none."""
        return self.aux.get(name, 0.0)

    def channels(self) -> tuple[Expr, ...]:
        """The five predictions in the order of `CHANNELS`."""
        return (self.imu_ax, self.imu_ay, self.yaw_acc, self.vx_dot, self.vy_dot)


@dataclass(frozen=True)
class SingleTrack:
    """The model of one vehicle with one list of active effects."""

    vehicle: Vehicle
    tyre_prior: Mapping[str, float]
    effects: tuple[Effect, ...] = ()
    tyre_std: Mapping[str, float] | None = None
    """how well the tyres are known beforehand, SI; default: as `tyre_parameters` says"""

    @property
    def layout(self) -> Layout:
        """That of its tyre parameters."""
        return layout_of(self.tyre_prior)

    @cached_property
    def tyre_table(self) -> tuple[Parameter, ...]:
        """Tyre parameters in the order of theta."""
        table = tyre_parameters(self.tyre_prior)
        known = self.tyre_std or {}
        return tuple(replace(p, prior_std=known.get(p.name, p.prior_std)) for p in table)

    @cached_property
    def load_rows(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Positions in theta of what the force of the front and of the rear axle depends on."""
        return load_rows([p.name for p in self.tyre_table], self.layout)

    @cached_property
    def effect_table(self) -> tuple[Parameter, ...]:
        """Parameters of the active effects, in order; names are `effect.parameter`."""
        return tuple(p for effect in self.effects for p in effect.parameters)

    def place_of(self, quantity: Quantity) -> int | None:
        """Position of a quantity in phi; None where no active effect has it."""
        return next((i for i, p in enumerate(self.effect_table) if p.quantity is quantity), None)

    def evaluate(self, terms: Terms, theta: Sequence[Expr], phi: Sequence[Expr] = ()) -> Terms:
        """Fill in every term from the signals, tyre parameters `theta` and effect parameters `phi`.

        An effect with a profile takes its value at the point as its parameter.
        """
        tyre = dict(zip((p.name for p in self.tyre_table), theta, strict=True))
        front, rear = (axle.of(tyre) for axle in front_and_rear(self.layout))
        v = self.vehicle
        self._hook(Stage.INPUT, terms, phi)
        terms.slip_f = slip_front(terms.vx, terms.vy, terms.yaw_rate, terms.steer, v)
        terms.slip_r = slip_rear(terms.vx, terms.vy, terms.yaw_rate, v)
        self._hook(Stage.SLIP, terms, phi)
        terms.fx_r = longitudinal_force(terms.drive, tyre["cx"])
        self._hook(Stage.LONGITUDINAL, terms, phi)
        self._hook(Stage.SATURATION, terms, phi)
        weight = 1.0 + terms.auxiliary("extra_load")
        terms.load_f, terms.load_r = weight * v.static_load_front, weight * v.static_load_rear
        self._hook(Stage.LOAD, terms, phi)
        self._hook(Stage.GRIP, terms, phi)
        front, rear = with_grip(terms.grip_f, *front), with_grip(terms.grip_r, *rear)
        terms.peak_f, terms.peak_r = peak_force(terms.load_f, *front), peak_force(terms.load_r, *rear)
        terms.fy_f = terms.across_f * lateral_force(terms.slip_f, terms.load_f, *front)
        terms.fy_r = terms.across_r * lateral_force(terms.slip_r, terms.load_r, *rear)
        self._hook(Stage.FORCE, terms, phi)
        self._hook(Stage.BODY, terms, phi)
        body_accelerations(terms)
        self._hook(Stage.MOTION, terms, phi)
        terms.vx_dot = terms.ax + terms.vy * terms.yaw_rate + terms.gravity_x
        terms.vy_dot = terms.ay - terms.vx * terms.yaw_rate + terms.gravity_y
        terms.imu_ax, terms.imu_ay = terms.ax, terms.ay
        self._hook(Stage.SENSOR, terms, phi)
        return terms

    def _hook(self, stage: Stage, terms: Terms, phi: Sequence[Expr]) -> None:
        start = 0
        for effect in self.effects:
            stop = start + len(effect.parameters)
            if hook := effect.hooks.get(stage.name):
                hook(terms, *phi[start:stop])
            start = stop


def body_accelerations(terms: Terms) -> None:
    """Eq. (1), forces to specific forces and yaw acceleration; the front axle may carry a longitudinal force."""
    v, sin, cos = terms.vehicle, ca.sin(terms.steer), ca.cos(terms.steer)
    front_x = terms.fx_f * cos - terms.fy_f * sin
    front_y = terms.fy_f * cos + terms.fx_f * sin
    terms.ax = (terms.fx_r + front_x + terms.body_x) / v.mass
    terms.ay = (terms.fy_r + front_y + terms.body_y) / v.mass
    terms.yaw_acc = (front_y * v.lf - terms.fy_r * v.lr + terms.body_yaw) / v.yaw_inertia
