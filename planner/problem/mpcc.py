"""The planner's optimal-control problem as symbolic stage functions: MPCC, Eq. (4), (5), and Infomax, Eq. (9), (10).

The stage function gives, for one interval and the state at its end, all the blocks of the QP of one SQP iteration;
CasADi maps it over the horizon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from estimator.model.discretise import rk4
from estimator.model.single_track import SingleTrack
from hil_gateway.process.arrays import Expr
from planner.problem import infomax, load_rows
from planner.problem.load_rows import LoadRow
from planner.problem.motion import BOUNDED, NU, NZ, PROGRESS, VX, S, dynamic_share
from planner.problem.settings import Settings
from planner.problem.stage_model import StageModel
from planner.problem.stage_parameters import common_names, stage_names

OUTPUTS = (
    "A", "B", "b", "Q", "q", "R", "r", "C", "lower_row", "upper_row", "lower_z", "upper_z", "lower_u", "upper_u",
)  # fmt: skip
"""Blocks of `qp.StageQp`, in the order of the stage function; `info`, `info_hessian` follow."""


ADVANCE_STEPS = 8
"""steps of `advance_function`; a plan starts some six steps of 10 ms after the estimate it is made from"""
STANDING_STEER = 0.02
"""share of its weight that a change of steering has at rest: (1.5 / 10)^2, as the force across that it makes"""
ZONE_ROUNDING = 0.05
"""m over which the force of the edge zone sets in: an iteration sees it coming"""


def path_errors(z: Expr, stage: Mapping[str, Expr]) -> tuple[Expr, Expr]:
    """Contouring and lag error, Eq. (5), m; the reference is the local cubic of the stage."""
    t = z[S] - stage["s"]
    powers, slopes = ca.vertcat(1, t, t**2, t**3), ca.vertcat(0, 1, 2 * t, 3 * t**2)
    x_d, y_d = ca.dot(stage["cubic_x"], powers), ca.dot(stage["cubic_y"], powers)
    dx, dy = ca.dot(stage["cubic_x"], slopes), ca.dot(stage["cubic_y"], slopes)
    norm = ca.sqrt(dx**2 + dy**2)
    cos, sin = dx / norm, dy / norm
    contouring = sin * (z[0] - x_d) - cos * (z[1] - y_d)
    lag = -cos * (z[0] - x_d) - sin * (z[1] - y_d)
    return contouring, lag


def offset_from_middle(z: Expr, stage: Mapping[str, Expr]) -> Expr:
    """Distance to the left of the middle of the track, m.

    Beside the race line the middle may move quickly, the width does not.
    """
    return -path_errors(z, stage)[0] - stage["centre"][0] - stage["centre"][1] * (z[S] - stage["s"])


def into_zone(z: Expr, stage: Mapping[str, Expr], zone: float) -> Expr:
    """How far into the last `zone` m before the bounds of the track, m: 0 outside of it, with a rounded corner."""
    offset = offset_from_middle(z, stage)
    inside = ca.sqrt(offset**2 + ZONE_ROUNDING**2) - (stage["half_width"] - zone)
    return 0.5 * (inside + ca.sqrt(inside**2 + ZONE_ROUNDING**2))


class Problem(StageModel):
    """Eq. (4), (5), (9), (10) for one model (list of active effects) and one set of settings."""

    def __init__(self, model: SingleTrack, settings: Settings) -> None:
        super().__init__(model, settings)
        self.stage, self.common = stage_names(model), common_names(model)
        self.informative = settings.information.weight > 0
        self.rows = ("track", "load_front", "load_rear", "speed", *(("information",) if self.informative else ()))

    def residuals(self, z: Expr, stage: Mapping[str, Expr]) -> Expr:
        """Least-squares terms of the stage cost; the Gauss-Newton Hessian is J'J."""
        w = self.settings.weights
        contouring, lag = path_errors(z, stage)
        terms = (
            (w.contouring, contouring),
            (w.lag, lag),
            (w.lateral_speed, z[4]),
            (w.yaw_rate, z[5]),
            (w.edge, into_zone(z, stage, self.settings.limits.edge_zone)),
        )
        return ca.vertcat(*(ca.sqrt(2 * weight) * value for weight, value in terms))

    def gauss_newton(self, residuals: Expr, z: Expr) -> tuple[Expr, Expr]:
        """Hessian J'J with a small multiple of the identity, and gradient."""
        J: Expr = ca.jacobian(residuals, z)
        return J.T @ J + self.settings.weights.regularisation * ca.DM.eye(NZ), J.T @ residuals

    def change_weights(self, vx: Expr) -> Expr:
        """Diagonal R of Eq. (4) times two; steering costs what it moves the car by, next to nothing at walking pace."""
        w, bounds = self.settings.weights, self.change_bounds()
        steered = STANDING_STEER + (1.0 - STANDING_STEER) * dynamic_share(vx)
        weights = (w.drive_change, w.steer_change * steered, w.progress_change)
        return ca.vertcat(*(2 * weight / bound**2 for weight, bound in zip(weights, bounds, strict=True)))

    def change_bounds(self) -> tuple[float, float, float]:
        """Largest change of each input over one interval (actuator bandwidths of Eq. (4))."""
        limits, dt = self.settings.limits, self.settings.dt
        return limits.drive_rate * dt, limits.steer_rate * dt, limits.progress_rate * dt

    def stage_rows(
        self, z: Expr, loads: Sequence[LoadRow], stage: Mapping[str, Expr], p: Mapping[str, Expr]
    ) -> tuple[Expr, Expr, Expr, Expr]:
        """Soft rows with their Jacobian, lower and upper bounds; the order is `rows`."""
        along = z[S] - stage["s"]
        offset = offset_from_middle(z, stage)
        speed = z[VX] - stage["speed"][0] - stage["speed"][1] * along
        values = [offset, loads[0].value, loads[1].value, speed]
        gradients = [ca.jacobian(offset, z), loads[0].gradient, loads[1].gradient, ca.jacobian(speed, z)]
        lower, upper = [-stage["half_width"], -1.0, -1.0, 0.0], [stage["half_width"], 1.0, 1.0, 0.0]
        if self.informative:
            gain = infomax.trace_gain(self, z, p) / self.settings.information.bound
            values, gradients = [*values, gain], [*gradients, ca.jacobian(gain, z)]
            lower, upper = [*lower, -1.0], [*upper, 1.0]
        return ca.vertcat(*values), ca.vertcat(*gradients), ca.vertcat(*lower), ca.vertcat(*upper)

    @property
    def mask_lower(self) -> tuple[float, ...]:
        """1 where the lower side of a soft row exists."""
        signed = float(self.settings.load_limit == "literal")
        return (1.0, signed, signed, 0.0, *((0.0,) if self.informative else ()))

    def slack(self) -> tuple[tuple[float, float], ...]:
        """L1 and L2 penalty of each soft row."""
        s = self.settings.slack
        return (s.track, s.load, s.load, s.speed, *((s.information,) if self.informative else ()))

    def stage_function(self) -> ca.Function:
        """(z, du, z_next, stage, common) -> blocks of the QP, Delta I at z_next and its exact Hessian."""
        z, zn = ca.SX.sym("z", NZ), ca.SX.sym("z_next", NZ)
        _, du, stage_vector, stage, common_vector, p = self._symbols()
        after = self.dynamics.step(z, du, p)
        residuals = self.residuals(zn, stage)
        Q, q = self.gauss_newton(residuals, zn)
        q[PROGRESS] -= stage["progress"]
        info = infomax.cost_terms(self, zn, p) if self.informative else infomax.no_terms()
        proximal = ca.vertcat(*(2 * self.settings.weights.proximal / b**2 for b in self.change_bounds()))
        weights = self.change_weights(z[VX])
        loads = [load_rows.worst_load(self, axle, zn, p) for axle in "fr"]
        for row, multiplier in zip(loads, ca.vertsplit(stage["multiplier"]), strict=True):
            Q += multiplier * row.curvature
        value, C, lower, upper = self.stage_rows(zn, loads, stage, p)
        limits = self.settings.limits
        bound_u = ca.DM(self.change_bounds())
        top = ca.vertcat(stage["drive_max"], limits.steer, limits.speed)
        bottom = ca.vertcat(limits.drive_min, -limits.steer, 0.0)
        bounded = ca.vertcat(*(zn[i] for i in BOUNDED))
        results = (
            ca.jacobian(after, z), ca.jacobian(after, du), after - zn, Q + info.hessian, q + info.gradient,
            ca.diag(weights + proximal), weights * du,
            C, lower - value, upper - value, bottom - bounded, top - bounded, -bound_u - du, bound_u - du,
            info.gain, info.exact_hessian,
        )  # fmt: skip
        arguments: Any = [z, du, zn, stage_vector, common_vector]
        dense: Any = [ca.densify(r) for r in ca.cse(list(map(ca.SX, results)))]
        names = ["z", "du", "z_next", "stage", "common"], [*OUTPUTS, "info", "info_hessian"]
        return ca.Function("stage", arguments, dense, *names)

    def horizon_function(self) -> ca.Function:
        """The stage function mapped over the horizon; `common` is given once."""
        stage: Any = self.stage_function()
        mapped: ca.Function = stage.map("horizon", "serial", self.settings.horizon, [4], [])
        return mapped

    def reference_functions(self) -> tuple[ca.Function, ca.Function]:
        """The same problem for solvers the SQP method is measured against.

        `cost`: (z_next, du, stage, common, theta_f, theta_r) -> stage cost without soft penalties, soft rows and
        their lower and upper bounds; `choice`: (z_next, stage, common) -> theta_f, theta_r, the choices of Eq. (10).
        """
        z, du, stage_vector, stage, common_vector, p = self._symbols()
        theta_f, theta_r = (ca.SX.sym(name, len(self.model.tyre_table)) for name in ("theta_f", "theta_r"))
        cost = 0.5 * ca.sumsqr(self.residuals(z, stage)) - stage["progress"] * z[PROGRESS]
        cost += 0.5 * ca.dot(self.change_weights(z[VX]), du**2)
        if self.informative:
            cost -= p["q_information"] * p["learning"] * infomax.weighted_gain(self, z, p)
        loads = [load_rows.load_row(self, axle, z, theta, p) for axle, theta in (("f", theta_f), ("r", theta_r))]
        value, _, lower, upper = self.stage_rows(z, loads, stage, p)
        arguments: Any = [z, du, stage_vector, common_vector, theta_f, theta_r]
        choices: Any = [load_rows.worst_choice(self, axle, z, p) for axle in "fr"]
        return (
            ca.Function("stage_cost", arguments, [cost, value, lower, upper]),
            ca.Function("choice", [z, stage_vector, common_vector], choices),
        )

    def _symbols(self) -> tuple[Expr, Expr, Expr, dict[str, Expr], Expr, dict[str, Expr]]:
        """State, change, stage vector and its parts, common vector, all parameters by name."""
        z, du = ca.SX.sym("z", NZ), ca.SX.sym("du", NU)
        stage_vector, common_vector = ca.SX.sym("stage", self.stage.size), ca.SX.sym("common", self.common.size)
        stage = self.stage.split(stage_vector)
        return z, du, stage_vector, stage, common_vector, {**stage, **self.common.split(common_vector)}

    def step_function(self) -> ca.Function:
        """(z, du, stage, common) -> z_next."""
        z, du, stage_vector, _, common_vector, p = self._symbols()
        return ca.Function("step", [z, du, stage_vector, common_vector], [self.dynamics.step(z, du, p)])

    def information_function(self) -> ca.Function:
        """(z of stages 1..N, common) -> F_k of Eq. (7) at the belief's mean, shape (n_theta, n_theta N)."""
        z, _, stage, _, common, p = self._symbols()
        arguments: Any = [z, common]
        F: Expr = ca.substitute(ca.densify(infomax.information_matrix(self, z, p)), stage, ca.SX.zeros(stage.shape))
        one: Any = ca.Function("information_stage", arguments, [F])
        mapped: ca.Function = one.map("information", "serial", self.settings.horizon, [1], [])
        return mapped

    def held_step(self) -> ca.Function:
        """(car[6], held[3] = drive, steer, s; stage, common) -> car after so many seconds with the inputs held.

        A brake holds a standing car, it does not push it backwards.
        """
        car, held = ca.SX.sym("car", 6), ca.SX.sym("held", 3)
        _, _, stage, _, common, p = self._symbols()
        u = ca.vertcat(held[0], held[1], 0.0)

        def f(x: Expr) -> Expr:
            return self.dynamics.derivative(ca.vertcat(x, p["s"]), u, p)[:6]

        after = rk4(f, car, held[2])
        after[VX] = ca.if_else(after[VX] < 0.0, 0.0, after[VX])  # keeps what is no number, which a maximum would not
        return ca.Function("held_step", [car, held, stage, common], [after])

    def advance_function(self) -> ca.Function:
        """`held_step` over K = `ADVANCE_STEPS` steps, all but the car given K times -> car (6, K) after each."""
        one: Any = self.held_step()
        steps: ca.Function = one.mapaccum("advance", ADVANCE_STEPS)
        return steps
