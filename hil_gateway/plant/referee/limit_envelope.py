"""The g-g-v diagram of the simulated car, measured on its own equations.

A point of the diagram is a quasi-steady manoeuvre: speed, load on the road and lateral force are held, yaw and wheels
accelerate with the car and no further, loads and slips have settled. Among all such manoeuvres (steering, body slip,
throttle, both brake circuits free) the one with the largest force is sought: Perantoni and Limebeer, Optimal control
for a Formula One car with variable parameters, Vehicle System Dynamics 52 (2014). Everything the plant knows is in it:
load transfer, air, load sensitivity, combined slip, engine map, gears, locking differential.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.interpolate import RegularGridInterpolator

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics import chassis, driveline
from hil_gateway.plant.physics.dynamics import INPUTS, OUTPUTS, STATES, rates_function
from hil_gateway.plant.physics.parameters import AV24, CarParameters, PlantParameters
from hil_gateway.plant.physics.tyre import LOW_SPEED
from hil_gateway.process.arrays import Array

TOP_SPEED = 80.0
"""m/s: the fastest the car's software ever asks for (288 km/h; the AV-24 has been driven at up to 290), so the limit
keeps to it too. The engine alone would reach 86 m/s."""
SLOWEST = 9.0
"""m/s; slower than any corner is driven"""
SPEEDS = np.linspace(SLOWEST, TOP_SPEED, 19)
NORMALS = GRAVITY * np.array([0.2, 0.6, 1.0, 1.5, 2.2])
"""weight on the road over mass, m/s2: from a crest to the turns of a banked oval at full speed"""
SHARES = np.array([0.0, 0.3, 0.55, 0.75, 0.9, 0.95, 0.98, 1.0])
"""of the largest lateral force, where the longitudinal ones are measured"""
SLIP_MAX = 0.15
"""longitudinal slip sought up to; tyres peak at 0.11"""
FEASIBLE = 1e-5
"""scaled defect up to which a manoeuvre counts, also where the search for a better one did not end by its own test"""
BISECTIONS = 9
"""to 1/500 of the range"""
WHEELS = ("fl", "fr", "rl", "rr")


class Scales(NamedTuple):
    """Units in which the unknowns are of order one. `ax` and `ay` are along and across the path, not the body: what a
    car that moves sideways loses of its lateral force along the path is in them."""

    vy: float = 1.0
    steer: float = 0.1
    slip_fl: float = 0.05
    slip_fr: float = 0.05
    slip_rl: float = 0.05
    slip_rr: float = 0.05
    throttle: float = 1.0
    brake_front: float = 1e6
    brake_rear: float = 1e6
    ax: float = 10.0
    ay: float = 10.0


AX, AY = Scales._fields.index("ax"), Scales._fields.index("ay")
START = np.array([0, 0, 0, 0, 0.2, 0.2, 0.2, 0, 0, 0, 0], dtype=float)


class LimitConditions(NamedTuple):
    """Held during a manoeuvre: m/s, m/s2, m/s against the car, engine over axle speed, factor on friction."""

    speed: float
    normal: float
    headwind: float
    ratio: float
    grip: float


class NoEquilibriumError(ArithmeticError):
    """The car has no quasi-steady state where one was sought."""


@dataclass(frozen=True)
class LimitEnvelope:
    """Largest forces over mass along and across the path, m/s2, over headwind, speed, load on the road and, along the
    path, the share of the lateral force.

    `lateral[0]` to the right, `lateral[1]` to the left, both positive, shape (2, W, V, N); `drive` and `brake` are the
    largest and the least longitudinal force beside the share of `SHARES` of the lateral one, shape (2, W, V, N, F).
    """

    headwinds: Array
    lateral: Array
    drive: Array
    brake: Array

    def peak(self, left: Array, headwind: Array, speed: Array, normal: Array) -> Array:
        """Largest lateral force to the side of `left` (bool), broadcast shape."""
        at = self._places(headwind, speed, normal)
        right, to_left = (self._interpolate(table, at) for table in self.lateral)
        return np.where(left, to_left, right)

    def along(self, table: Array, share: Array, headwind: Array, speed: Array, normal: Array) -> Array:
        """`drive` or `brake` beside the signed share -1 (right) to 1 (left) of the lateral force."""
        angle = np.arccos(np.clip(np.abs(share), 0.0, 1.0))
        at = (*self._places(headwind, speed, normal), angle)
        right, to_left = (self._interpolate(side[..., ::-1], at) for side in table)
        return np.where(share > 0, to_left, right)

    def _places(self, headwind: Array, speed: Array, normal: Array) -> tuple[Array, ...]:
        low, high = self.headwinds[0], self.headwinds[-1]
        normal = np.clip(normal, NORMALS[0], NORMALS[-1])
        return np.clip(headwind, low, high), np.clip(speed, SLOWEST, TOP_SPEED) ** 2, normal

    def _interpolate(self, table: Array, at: tuple[Array, ...]) -> Array:
        """Linear in headwind, v^2, load and the angle whose cosine is the share of the lateral force."""
        axes = [self.headwinds, SPEEDS**2, NORMALS, np.arccos(SHARES[::-1])][: table.ndim]
        if len(self.headwinds) == 1:
            axes, table, at = axes[1:], table[0], at[1:]
        points = np.stack(np.broadcast_arrays(*at), axis=-1)
        return np.asarray(RegularGridInterpolator(axes, table)(points))


def measure_envelope(parameters: PlantParameters, grip: float = 1.0) -> LimitEnvelope:
    """Envelope of a car, with all its friction times `grip`.

    Raises:
        NoEquilibriumError: a car that cannot be balanced at some speed.
    """
    car = parameters.car
    wind = float(np.hypot(car.wind_x, car.wind_y))
    headwinds = np.array([-wind, 0.0, wind]) if wind else np.zeros(1)
    sides = [Side(parameters, sign, grip) for sign in ((-1.0, 1.0) if car.turn_asymmetry else (1.0,))]
    axes = headwinds, SPEEDS, NORMALS
    shape = tuple(len(axis) for axis in axes)
    tables = np.empty((len(sides), *shape, 1 + 2 * len(SHARES)))
    for i, side in enumerate(sides):
        for place in np.ndindex(*shape):
            tables[(i, *place)] = side.measure(*(float(axis[k]) for axis, k in zip(axes, place, strict=True)))
    both = np.broadcast_to(tables, (2, *tables.shape[1:]))  # a car that is alike to both sides is measured once
    n = len(SHARES)
    return LimitEnvelope(headwinds, both[..., 0], both[..., 1 : 1 + n], both[..., 1 + n :])


def best_ratio(parameters: PlantParameters, speed: float) -> float:
    """Engine over axle speed in the gear with the largest force at the wheels."""
    car = parameters.car
    axle = speed / car.wheel_radius

    def force(ratio: float) -> float:
        turns = max(axle * ratio, car.engine_clutch)
        return ratio * float(driveline.full_throttle_torque(turns, list(car.engine_torque), car.engine_speed_scale))

    return max((gear * parameters.final_drive for gear in parameters.gears), key=force)


class Side:
    """Manoeuvres of one car to one side."""

    def __init__(self, parameters: PlantParameters, sign: float, grip: float) -> None:
        self._parameters, self._sign, self._grip = parameters, sign, grip
        calm: Any = {"wind_x": 0.0, "wind_y": 0.0}  # the wind comes in by `headwind`
        self._vector = CarParameters(**{**_values(parameters.car), **calm}).vector()

    def measure(self, headwind: float, speed: float, normal: float) -> Array:
        """Largest lateral force, then driving and braking beside each share of it, shape (1 + 2 F,)."""
        ratio = best_ratio(self._parameters, speed)
        held = [*LimitConditions(speed, normal, headwind, ratio, self._grip), *self._vector]
        drive, brake = (self._extreme(held, START, (sign, 0.0), 0.0) for sign in (1.0, -1.0))
        peak = self._peak(held)
        drives = self._along(held, drive, peak, (1.0, 0.0))
        brakes = self._along(held, brake, peak, (-1.0, 0.0))
        return Scales().ax * np.array([abs(peak[AY]), *drives, *brakes])

    def _along(self, held: list[float], start: Array, peak: Array, direction: tuple[float, float]) -> list[float]:
        """Longitudinal force beside every share of the lateral one, from straight ahead to the peak."""
        guess, row = start, [float(start[AX])]
        for before, share in pairwise(SHARES[:-1]):
            chord, last = guess + (peak - guess) * (share - before) / (1.0 - before), guess
            guess = chord  # where nothing is found it stays: it lies inside the diagram, which is convex
            for begin in (last, chord):
                with suppress(NoEquilibriumError):
                    guess = self._extreme(held, begin, direction, share * peak[AY])
                    break
            row.append(float(guess[AX]))
        return [*row, float(peak[AX])]

    def _peak(self, held: list[float]) -> Array:
        """The manoeuvre with the largest lateral force, brakes off, reached over slower turns."""
        car, guess = self._parameters.car, START
        tightest = held[0] ** 2 * car.steer_max / car.wheelbase
        for share in (0.4, 0.8):
            lateral = self._sign * share * min(held[1], tightest) / Scales().ay
            with suppress(NoEquilibriumError):  # a car with little grip under a large load does not turn so fast
                guess = self._extreme(held, guess, (0.0, 0.0), lateral)
        try:
            peak = self._extreme(held, guess, (0.0, self._sign), None)
        except NoEquilibriumError:
            if guess is START:
                raise
            return self._climb(held, guess)
        # the search may settle where the car slides to the other side
        return peak if self._sign * (peak[AY] - guess[AY]) >= 0.0 else self._climb(held, guess)

    def _climb(self, held: list[float], guess: Array) -> Array:
        """The largest lateral force by bisection, where the search for it does not settle."""
        low, high = float(guess[AY]), 3.0 * float(guess[AY])
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            try:
                guess, low = self._extreme(held, guess, (0.0, 0.0), middle), middle
            except NoEquilibriumError:
                high = middle
        return guess

    def _extreme(
        self,
        held: list[float],
        start: Array,
        direction: tuple[float, float],
        lateral: float | None,
    ) -> Array:
        """Scaled unknowns of the manoeuvre that goes farthest in `direction`, the lateral force held where it is given.

        Braking uses the brakes, all else the throttle, never both at once: the locking differential would turn braking
        against the engine into a yaw moment, which nothing that drives does.
        """
        throttle, brakes = (0.0, 1.0) if direction[0] < 0 else (1.0, 0.0)
        pressure = brakes * self._parameters.pressure_max / Scales().brake_front
        slips = [SLIP_MAX / Scales().slip_fl] * 4
        steer = self._parameters.car.steer_max / Scales().steer
        top = np.array([0.25 * held[0], steer, *slips, throttle, pressure, pressure, 8, 8])
        low = -top
        low[6:9] = 0.0
        if lateral is not None:
            low[AY] = top[AY] = lateral
        for guess, patient in ((start, False), (START, False), (start, True), (START, True)):
            solver = _solver(patient)
            result = solver(x0=guess, p=[*direction, *held], lbx=low, ubx=top, lbg=0.0, ubg=0.0)
            if solver.stats()["success"] or float(ca.norm_inf(result["g"])) < FEASIBLE:
                return np.asarray(result["x"], dtype=float).ravel()
        raise NoEquilibriumError(
            f"no quasi-steady state at {held[0]:.0f} m/s, load {held[1]:.1f} m/s2, lateral {lateral}"
        )


def _values(car: CarParameters) -> dict[str, Any]:
    return {name: getattr(car, name) for name in car.__dataclass_fields__}


@cache
def _solver(patient: bool) -> ca.Function:
    """max direction . (ax, ay) over the unknowns, subject to quasi-steady motion.

    Patient: for the few places the quick search, which stays near its guess, does not get through.
    """
    unknowns, direction = ca.SX.sym("w", len(Scales._fields)), ca.SX.sym("d", 2)
    held, vector = ca.SX.sym("h", len(LimitConditions._fields)), ca.SX.sym("p", len(AV24.car.vector()))
    w = Scales._make(unknowns[i] * scale for i, scale in enumerate(Scales()))
    p = AV24.car.symbols(vector)
    defects = _defects(w, LimitConditions._make(ca.vertsplit(held)), vector, p)
    problem: dict[str, Any] = {
        "x": unknowns,
        "p": ca.vertcat(direction, held, vector),
        # of several manoeuvres with the same force the one with the least pedals
        "f": -direction[0] * unknowns[AX] - direction[1] * unknowns[AY] + 1e-4 * ca.sumsqr(unknowns[6:9]),
        "g": defects,
    }
    options: dict[str, Any] = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-6,
               "ipopt.max_iter": 60, "error_on_fail": False}  # fmt: skip
    near = {"ipopt.mu_init": 1e-3, "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4}
    far = {"ipopt.mu_strategy": "adaptive", "ipopt.max_iter": 400}
    options |= far if patient else near
    return ca.nlpsol("manoeuvre", "ipopt", problem, options)


def _defects(w: Any, held: LimitConditions, vector: Any, p: Any) -> Any:
    """What must vanish: forces as supposed, no yaw acceleration, wheels that speed up as the car does."""
    yaw_rate = w.ay / held.speed
    vx, sin = ca.sqrt(held.speed**2 - w.vy**2), w.vy / held.speed
    cos = vx / held.speed
    ax, ay = w.ax * cos - w.ay * sin, w.ax * sin + w.ay * cos
    state, inputs = dict.fromkeys(STATES, 0.0), dict.fromkeys(INPUTS, 0.0)
    state |= {"vx": vx, "vy": w.vy, "yaw_rate": yaw_rate, "load_ax": ax, "load_ay": ay}
    state |= {name: getattr(w, name) for name in ("throttle", "brake_front", "brake_rear")}
    state["steer"] = (w.steer - p.steer_offset) / p.steer_scale
    for i, name in enumerate(WHEELS):
        x, y = (axis[i] for axis in chassis.wheel_positions(p))
        steer = w.steer if i in chassis.FRONT else 0.0
        along, across = chassis.wheel_velocity(vx, w.vy, yaw_rate, x=x, y=y, steer=steer)
        speed, slip = ca.sqrt(along**2 + LOW_SPEED**2), getattr(w, f"slip_{name}")
        state |= {f"slip_x_{name}": slip, f"slip_y_{name}": -across / speed}
        state[f"spin_{name}"] = (along + slip * speed) / p.wheel_radius
    inputs |= {"ratio": held.ratio, "engine_running": 1.0, "gravity_z": held.normal, "grip": held.grip}
    inputs |= {f"late_{name}": state[name] for name in ("steer", "throttle", "brake_front", "brake_rear")}
    windy = ca.SX(vector)
    windy[list(CarParameters.__dataclass_fields__).index("wind_x")] = -held.headwind  # tuples come after it
    rates, outputs = rates_function()(ca.vertcat(*state.values()), ca.vertcat(*inputs.values()), windy)
    out = dict(zip(OUTPUTS, ca.vertsplit(outputs), strict=True))
    spins = [rates[STATES.index(f"spin_{name}")] * p.wheel_radius - w.ax for name in WHEELS]
    return ca.vertcat(
        (out["ax"] - ax) / 10.0, (out["ay"] - ay) / 10.0, out["yaw_acc"] / 10.0, *(s / 100 for s in spins)
    )
