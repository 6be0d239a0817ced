"""Prepares a solution for `acceptance`: the plan as it would be published, beside the track, with its bounds.

Offsets and widths come from the race line by plain projection, forces from the equations of the declared model
written out again in numpy, or, with active effects, from the model evaluated by CasADi's interpreter.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from estimator.belief.revision import RevisedModel
from estimator.model.single_track import SIGNALS, SingleTrack, Terms
from estimator.model.tyre import front_and_rear
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import CompiledFunction, compile_function
from planner.adoption.adoption import Adopted
from planner.line.raceline import RaceLine
from planner.plan import acceptance
from planner.plan.acceptance import AxleForces, Bounds, ForceModel
from planner.plan.controller import Controller
from planner.problem.brake_law import BrakeLaw
from planner.problem.motion import MOST_LIFT
from planner.problem.settings import Settings
from planner.solver.sqp import Solution

WINDOW = 6
"""points of the race line either side of the predicted progress among which the nearest is sought"""


class PlanCheck:
    """Checks solutions of one planner.

    `first_loads` are the shares of the load limits at the plan's start, `worst_load` the largest share after it,
    `first_gain` is Delta I of its first stage.
    """

    def __init__(self, settings: Settings, vehicle: Vehicle) -> None:
        self._settings, self._vehicle = settings, vehicle
        self._model: RevisedModel | None = None
        self._forces: ForceModel | None = None
        self._brake_ratio = 1.0
        self._built: tuple[tuple[str, ...], InterpretedForces] | None = None
        self.first_loads, self.worst_load = (0.0, 0.0), 0.0
        self.first_gain = 0.0

    def __call__(self, controller: Controller, adopted: Adopted, solution: Solution) -> list[str]:
        """Limits the solution breaks, in words; empty when it may be published."""
        forces = self._force_model(adopted, controller.knowledge.brake_ratio)
        bounds = bounds_of(self._settings, controller.knowledge.load_max, float(solution.z[7, 0]))
        plan = plan_of(solution, controller.reference.line)
        felt = acceptance.stage_forces(plan, forces)
        loads = acceptance.shares_of(plan, bounds, felt)
        self.first_loads = float(loads[0][0]), float(loads[1][0])
        self.worst_load = float(max(share[1:].max() for share in loads))
        self.first_gain = float(solution.information[0])
        gaps = defects(plan, bounds.dt, forces, self._vehicle, felt)
        return acceptance.violations(plan, bounds, forces, gaps, loads)

    def _force_model(self, adopted: Adopted, brake_ratio: float) -> ForceModel:
        if self._forces is None or adopted.revised is not self._model or brake_ratio != self._brake_ratio:
            self._model, self._brake_ratio = adopted.revised, brake_ratio
            effects = adopted.revised.model.effects
            self._forces = (
                self._interpreted(adopted.revised.model).of(adopted.revised, brake_ratio) if effects
                else acceptance.declared_forces(self._vehicle, adopted.revision.tyre)
            )  # fmt: skip
        return self._forces

    def _interpreted(self, model: SingleTrack) -> InterpretedForces:
        """Built once for the effects of `model`: refined parameters are not worth 15 ms of a plan."""
        effects = tuple(effect.name for effect in model.effects)
        if self._built is None or self._built[0] != effects:
            self._built = effects, InterpretedForces(model, self._settings.brakes)
        return self._built[1]


def bounds_of(settings: Settings, load_max: tuple[float, float], drive: float) -> Bounds:
    """Limits of Eq. (4), (9), (10); `drive` is where the plan starts, which may still be outside its range."""
    limits, info = settings.limits, settings.information
    return Bounds(
        dt=settings.dt, steer=limits.steer, steer_rate=limits.steer_rate,
        drive=(min(limits.drive_min, drive), max(limits.drive_max, drive)), drive_rate=limits.drive_rate,
        speed=limits.speed, load_max=load_max, clearance=limits.car_half_width,
        literal_load=settings.load_limit == "literal", information=info.bound if info.weight > 0 else np.inf,
    )  # fmt: skip


def plan_of(solution: Solution, line: RaceLine) -> acceptance.Plan:
    """The solution beside the race line."""
    z = solution.z
    offset, width_left, width_right, index = beside(z[0], z[1], z[6], line)
    return acceptance.Plan(
        x=z[0], y=z[1], yaw=z[2], vx=z[3], vy=z[4], yaw_rate=z[5], drive=z[7], steer=z[8], offset=offset,
        width_left=width_left, width_right=width_right, extra_load=_extra_load(line, index, z[3], z[5]),
        information=np.concatenate([[0.0], solution.information]),
    )  # fmt: skip


def _extra_load(line: RaceLine, index: npt.NDArray[np.intp], vx: Array, yaw_rate: Array) -> Array:
    """What the road adds to the axle loads at points of the line, over the weight, (K,)."""
    grade, bank, bend = line.grade[index], line.bank[index], line.bend[index]
    added = np.cos(grade) * np.cos(bank) - 1.0 + vx * (vx * bend - yaw_rate * np.sin(bank)) / GRAVITY
    return np.asarray(np.maximum(added, -MOST_LIFT))


def beside(x: Array, y: Array, s: Array, line: RaceLine) -> tuple[Array, Array, Array, npt.NDArray[np.intp]]:
    """Distance to the left of the line (m) of points (K,) near progress `s`, the line's distance to both edges, and
    the nearest point of the line."""
    n = len(line.s)
    around = np.round(s / line.length * n)[:, None] + np.arange(-WINDOW, WINDOW + 1)
    index = (around % n).astype(np.intp)
    dx, dy = x[:, None] - line.x[index], y[:, None] - line.y[index]
    nearest = np.argmin(dx**2 + dy**2, axis=1)
    rows = np.arange(len(x))
    i, dx, dy = index[rows, nearest], dx[rows, nearest], dy[rows, nearest]
    cos, sin = np.cos(line.heading[i]), np.sin(line.heading[i])
    cells = (cos * dx + sin * dy) * n / line.length
    left, right = (w[i] + cells * 0.5 * (w[(i + 1) % n] - w[i - 1]) for w in (line.width_left, line.width_right))
    return cos * dy - sin * dx, left, right, i


MIN_DYNAMIC_SPEED = 12.0
"""m/s: below it the plan is kinematic and its lateral motion is not judged by Eq. (1)"""


def defects(
    plan: acceptance.Plan, dt: float, forces: ForceModel, vehicle: Vehicle, felt: AxleForces | None = None
) -> Array:
    """Gap (6, N) between each stage and the motion by Eq. (1) from the one before: Hermite-Simpson defects.

    Inputs run straight from stage to stage; `felt` are the forces at the stages where they are known. Gravity on
    grade and bank is left out: far below what counts as a gap.
    Source: Hargraves & Paris, J. Guidance 10 (1987).
    """
    state = np.vstack([plan.x, plan.y, plan.yaw, plan.vx, plan.vy, plan.yaw_rate])
    inputs = np.vstack([plan.steer, plan.drive, plan.extra_load])
    slope = _motion(state, inputs[0], felt or acceptance.stage_forces(plan, forces), vehicle)
    before, after, slope_before, slope_after = state[:, :-1], state[:, 1:], slope[:, :-1], slope[:, 1:]
    middle = 0.5 * (before + after) + dt / 8 * (slope_before - slope_after)
    steer, drive, extra = 0.5 * (inputs[:, :-1] + inputs[:, 1:])
    between = forces(middle[3], middle[4], middle[5], steer, drive, extra_load=extra)
    slope_middle = _motion(middle, steer, between, vehicle)
    gap = after - before - dt / 6 * (slope_before + 4 * slope_middle + slope_after)
    judged = before[3] > MIN_DYNAMIC_SPEED
    gap[:3] *= judged
    gap[4:] *= judged
    return gap


def _motion(state: Array, steer: Array, f: AxleForces, vehicle: Vehicle) -> Array:
    """Eq. (1)."""
    _, _, yaw, vx, vy, rate = state
    (cos_yaw, cos_steer), (sin_yaw, sin_steer) = np.cos([yaw, steer]), np.sin([yaw, steer])
    front_x = f.fx_f * cos_steer - f.fy_f * sin_steer
    front_y = f.fy_f * cos_steer + f.fx_f * sin_steer
    slope = np.empty_like(state)
    slope[0] = vx * cos_yaw - vy * sin_yaw
    slope[1] = vx * sin_yaw + vy * cos_yaw
    slope[2] = rate
    slope[3] = (f.fx_r + front_x) / vehicle.mass + vy * rate
    slope[4] = (f.fy_r + front_y) / vehicle.mass - vx * rate
    slope[5] = (front_y * vehicle.lf - f.fy_r * vehicle.lr) / vehicle.yaw_inertia
    return slope


class InterpretedForces:
    """Axle forces of a model with effects, evaluated by CasADi's interpreter at the start of the lap's profiles."""

    def __init__(self, model: SingleTrack, brakes: BrakeLaw) -> None:
        """`model` gives layout and effects, `brakes` how braking is split; parameters come with `of`."""
        self._names = [p.name for p in model.tyre_table]
        self._axles = front_and_rear(model.layout)
        felt, theta = ca.SX.sym("felt", len(SIGNALS) + 2), ca.SX.sym("theta", len(self._names))
        phi = ca.SX.sym("phi", len(model.effect_table))
        *signals, extra, ratio = ca.vertsplit(felt)
        named: dict[str, Any] = dict(zip(SIGNALS, signals, strict=True))
        balance = brakes.balance(named["vx"], named["drive"], ratio)
        terms = Terms(model.vehicle, **named, aux={"extra_load": extra, "brake_balance": balance})
        terms = model.evaluate(terms, ca.vertsplit(theta), ca.vertsplit(phi) if phi.numel() else [])
        names = ("fx_f", "fy_f", "load_f", "fx_r", "fy_r", "load_r", "slip_f", "slip_r")
        result = ca.densify(ca.vertcat(*(getattr(terms, n) for n in names)))
        self._function = ca.Function("forces", [felt, theta, phi], [result])
        self._at_once: dict[int, CompiledFunction] = {}

    def of(self, revised: RevisedModel, brake_ratio: float) -> ForceModel:
        """With the parameters of a revision of this model, and its ratio of the brake pressures."""
        theta, phi = revised.theta, revised.phi_at(np.zeros(1))[:, 0]
        rows = [list(axle.rows(self._names)[:2]) for axle in self._axles]
        b, c = np.array([theta[row] for row in rows]).T[:, :, None]

        def forces(
            vx: Array, vy: Array, yaw_rate: Array, steer: Array, drive: Array, *, extra_load: Array | float = 0.0
        ) -> AxleForces:
            run = self._over(len(vx))
            for row, values in enumerate((vx, vy, yaw_rate, steer, drive, extra_load, brake_ratio)):
                run.inputs[0][row] = values
            run.inputs[1][:], run.inputs[2][:] = theta[:, None], phi[:, None]
            run()
            values = run.outputs[0].copy()
            return AxleForces(*values[:6], *acceptance.beyond_peak(c * np.arctan(b * values[6:])))

        return forces

    def _over(self, stages: int) -> CompiledFunction:
        """The function over so many stages, in CasADi's virtual machine."""
        if stages not in self._at_once:
            self._at_once[stages] = compile_function(self._function.map(stages), compiled=False)
        return self._at_once[stages]
