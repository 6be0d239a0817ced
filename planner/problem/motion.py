"""State, control and motion of the plan: z_{k+1} = F(z_k, du_k), Eq. (1) over one interval.

State z = [X, Y, yaw, v_x, v_y, omega, s, d, delta, v_s]: Eq. (1) and the inputs themselves; the control is their
change over one interval, along which they move linearly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from estimator.model.discretise import state_derivative
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr
from planner.problem.brake_law import BrakeLaw

STATES = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "s", "drive", "steer", "progress")
CONTROLS = ("drive_change", "steer_change", "progress_change")
NZ, NU = len(STATES), len(CONTROLS)
VX, YAW_RATE, S, DRIVE, STEER, PROGRESS = map(STATES.index, ("vx", "yaw_rate", "s", "drive", "steer", "progress"))
BOUNDED = (DRIVE, STEER, PROGRESS)
"""states with hard bounds: the inputs of the car"""

BLEND_SPEED = 6.0
BLEND_WIDTH = 1.5
KINEMATIC_TIME = 0.15
"""Below about 6 m/s tyre dynamics are too stiff for one step of 0.05 s and the car is driven kinematically."""

MOST_LIFT, LIFT_SMOOTHING = 0.8, 0.05
"""share of the weight that a crest takes off at most, and the width of that bound"""

HOLD_SPEED = 0.5
"""m/s: below about this deceleration fades to nothing"""


def auxiliary(model: SingleTrack, brakes: BrakeLaw, z: Sequence[Expr], p: Mapping[str, Expr]) -> dict[str, Expr]:
    """Signals effects may need, as far as a plan knows them; the rest is neutral. So are the rates of the inputs: those
    of a plan are the ones that act."""
    lap, extra = p["lap"], extra_load(p["road_load"], z[VX], z[5])
    known = {
        "track_position": z[S] - lap * ca.floor(z[S] / lap),
        "yaw": z[2],
        "ax": p["theta"][0] * z[DRIVE] / model.vehicle.mass,
        "brake_balance": brakes.balance(z[VX], z[DRIVE], p["brake_ratio"], extra),
        "extra_load": extra,
    }
    return {name: known.get(name, 0.0) for name in AUXILIARY}


def extra_load(road: Expr, vx: Expr, yaw_rate: Expr) -> Expr:
    """What the road adds to the axle loads at this motion, over the weight; `road` are the rows of `Reference.stages`.

    Kept above -`MOST_LIFT`: a car that takes off needs another model.
    """
    extra = road[0] + road[1] * vx * vx - road[2] * vx * yaw_rate
    root = math.sqrt if isinstance(extra, float) else ca.sqrt  # which serves numbers too, 10 us later
    return -MOST_LIFT + 0.5 * (extra + MOST_LIFT + root((extra + MOST_LIFT) ** 2 + LIFT_SMOOTHING**2))


def split(vector: Expr) -> list[Expr]:
    """Elements of a column vector."""
    return ca.vertsplit(vector) if vector.numel() else []


def dynamic_share(vx: Expr) -> Expr:
    """Share of the tyre dynamics in the motion: 0 at standstill, 1 from about 10 m/s on."""
    return 0.5 * (1.0 + ca.tanh((vx - BLEND_SPEED) / BLEND_WIDTH))


@dataclass(frozen=True)
class Dynamics:
    """z_{k+1} = F(z_k, du_k): Eq. (1) with a kinematic blend at low speed, inputs ramping over the interval."""

    model: SingleTrack
    dt: float
    brakes: BrakeLaw

    def derivative(self, x: Expr, u: Expr, p: Mapping[str, Expr]) -> Expr:
        """d/dt of the seven car states for inputs u = [d, delta, v_s]."""
        z = ca.vertsplit(ca.vertcat(x, u))
        theta, phi = split(p["theta"]), split(p["phi"])
        aux = auxiliary(self.model, self.brakes, z, p)
        car = state_derivative(self.model, z[:6], (z[STEER], z[DRIVE]), theta, phi, aux=aux)
        _, _, _, vx, vy, yaw_rate, _, _, steer, progress = z
        weight = dynamic_share(vx)
        v = self.model.vehicle
        gravity = [GRAVITY * ca.sin(p[name]) for name in ("grade", "bank")]
        rolling_yaw_rate = vx * ca.tan(steer) / v.wheelbase
        lateral = (v.lr * rolling_yaw_rate - vy) / KINEMATIC_TIME
        yaw = (rolling_yaw_rate - yaw_rate) / KINEMATIC_TIME
        along = car[3] - gravity[0]
        # brakes hold a standing car, they do not push it backwards
        along = ca.fmax(along, 0.0) + ca.fmin(along, 0.0) * ca.tanh(ca.fmax(vx, 0.0) / HOLD_SPEED)
        sliding, turning = weight * (car[4] - gravity[1]), weight * car[5]
        blended = ca.vertcat(sliding + (1 - weight) * lateral, turning + (1 - weight) * yaw)
        return ca.vertcat(car[:3], along, blended, progress)

    def step(self, z: Expr, du: Expr, p: Mapping[str, Expr]) -> Expr:
        """One interval by RK4; the inputs move linearly from u to u + du, as far as that is not decided before."""
        x, u, h = z[:7], z[7:], self.dt
        du = ca.vertcat(p["free"] * du[:2] + p["sent"], du[2])

        def f(state: Expr, share: float) -> Expr:
            return self.derivative(state, u + share * du, p)

        k1 = f(x, 0.0)
        k2 = f(x + h / 2 * k1, 0.5)
        k3 = f(x + h / 2 * k2, 0.5)
        k4 = f(x + h * k3, 1.0)
        return ca.vertcat(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), u + du)
