"""Planner in closed loop on its own model: timings, safety figures, and IPOPT on the same problems in the same run.

Durations are CPU time of the thread, so that other work on the machine does not count as the solver's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.plans.reference_nlp import ReferenceNlp
from estimator.belief.information import fisher_information, trace_criterion
from estimator.belief.revision import declared_revision, model_of
from estimator.belief.tyre_belief import measured_std
from estimator.model.measurement import measurement_function
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track
from planner.line.envelope import envelope_of
from planner.line.raceline import OptimisedLine, raceline_for
from planner.line.track import Reference
from planner.plan import acceptance
from planner.plan.checks import Roadside, bounds_of, plan_of
from planner.plan.controller import Controller, TyreKnowledge
from planner.problem.checked_motion import LIMITS
from planner.problem.motion import NZ, PROGRESS, VX, S
from planner.problem.mpcc import Problem
from planner.problem.settings import Settings
from planner.solver.functions import build_functions
from planner.solver.sqp import Solution

BELIEF_STD = 0.05
"""relative standard deviation of the tyre parameters in the benchmark's belief"""
LOAD_USE, PROFILE_USE, MARGIN = 0.95, 0.80, 1.9
IPOPT_EVERY = 40
"""steps between two comparisons with IPOPT; the step before each gives IPOPT its multipliers"""
TIME_LIMIT_S = 300.0
INFORMATION_WEIGHT = 0.01
"""q_I when information is on"""
EXECUTED_TOLERANCE = {"track": 0.0, "load": 0.02, "actuator": 1e-6, "information": 0.02}
"""what counts as a violation by an executed state: m beyond the edge, shares of the bounds"""

clock = time.thread_time_ns


@dataclass
class Run:
    """Record of one closed-loop drive; lists have one entry a step."""

    measurement: ca.Function
    solve_ns: list[int] = field(default_factory=list)
    linearise_ns: list[int] = field(default_factory=list)
    qp_ns: list[int] = field(default_factory=list)
    ipopt_ns: list[int] = field(default_factory=list)
    states: list[Array] = field(default_factory=list)
    information: list[float] = field(default_factory=list)
    cost: list[float] = field(default_factory=list)
    step_norm: list[float] = field(default_factory=list)
    violations: dict[str, int] = field(default_factory=lambda: dict.fromkeys(EXECUTED_TOLERANCE, 0))
    qp_failures: int = 0
    lap_times_s: list[float] = field(default_factory=list)


def bench_controller(
    track: Track, vehicle: Vehicle, settings: Settings, *, backend: str = "auto", compiled: bool = True
) -> tuple[Controller, OptimisedLine]:
    """Controller of the declared model on the race line of a track, with a belief of 5 %."""
    revised = model_of(declared_revision(tyre_prior(load_car(), "per_axle")), vehicle, track.length)
    problem = Problem(revised.model, settings)
    # plans that explore leave more of the load limits alone: a profile that does not enters bends too fast for them
    use = (1.0 - (settings.limits.exploring_reserve if problem.informative else 0.0)) * PROFILE_USE
    envelope = envelope_of(revised.model, list(revised.theta), use=(use, use), car=load_car())
    line = raceline_for(track, envelope, MARGIN)
    theta, names = revised.theta, [p.name for p in revised.model.tyre_table]
    judged = LOAD_USE * theta[names.index("df")], LOAD_USE * theta[names.index("dr")]
    prior_std, covariance = (
        np.array([p.prior_std for p in revised.model.tyre_table]),
        np.diag((BELIEF_STD * theta) ** 2),
    )
    knowledge = TyreKnowledge(theta, theta, covariance, prior_std, judged, (LOAD_USE, LOAD_USE), judged)
    functions = build_functions(problem, compiled)
    return Controller(problem, functions, Reference(line), knowledge, backend=backend), line


def start_state(controller: Controller, s: float = 0.0, share: float = 0.9) -> Array:
    """On the race line at a share of its speed profile."""
    point = controller.reference.at(np.array([s]))
    speed = share * float(controller.reference.speed_limit(np.array([s]))[0])
    z = np.zeros(NZ)
    z[:4] = point.x[0], point.y[0], point.heading[0], speed
    z[S], z[PROGRESS] = s, speed
    return z


def drive(
    controller: Controller, laps: int, *, ipopt: bool = False, converge: int = 0, steps: int | None = None
) -> Run:
    """Closed loop on the controller's own model from a rolling start.

    `converge` > 0 solves every step with up to that many SQP iterations instead of the settings' number.
    """
    kind = controller.settings.information.kind
    run, z, dt = (
        Run(measurement_function(controller.problem.model, kind)),
        start_state(controller),
        controller.settings.dt,
    )
    controller.cold_start(z, clock)
    nlp = ReferenceNlp(controller) if ipopt else None
    crossing, length = 0.0, controller.reference.length
    for k in range(steps or round(laps * TIME_LIMIT_S / dt)):
        if nlp is not None:
            _compare(nlp, controller, z, k, run)
        started = clock()
        solution = controller.solve(z, clock)
        run.solve_ns.append(clock() - started)
        if converge:
            solution = _converge(controller, z, solution, converge)
        _note(run, controller, z, solution)
        if not solution.usable:
            controller.cold_start(z, clock)
        before = z
        z = controller.sqp.propagate(z, controller.sqp.du[:, 0], controller.stages[:, 0], controller.common)
        controller.shift()
        if z[S] // length > before[S] // length:
            now = (k + (length - before[S] % length) / (z[S] - before[S])) * dt
            run.lap_times_s.append(now - crossing)
            crossing = now
            if len(run.lap_times_s) == laps:
                break
    return run


def _converge(controller: Controller, z: Array, solution: Solution, limit: int) -> Solution:
    for _ in range(limit):
        if not solution.usable or solution.step_norm < 1e-4:
            break
        solution = controller.solve(z, clock, 1)
    return solution


def _compare(nlp: ReferenceNlp, controller: Controller, z: Array, k: int, run: Run) -> None:
    """IPOPT from the very guess the SQP method starts from, every now and then."""
    if k % IPOPT_EVERY not in (IPOPT_EVERY - 2, IPOPT_EVERY - 1):
        return
    guess = controller.sqp.z.copy()
    guess[:, 0] = z
    controller.fill_stages(float(z[7]))
    result = nlp.solve(z, guess, controller.sqp.du.copy(), clock)
    if k % IPOPT_EVERY == IPOPT_EVERY - 1 and result.converged:
        run.ipopt_ns.append(result.solve_ns)


def _note(run: Run, controller: Controller, z: Array, solution: Solution) -> None:
    run.states.append(z.copy())
    run.qp_failures += not solution.usable
    run.linearise_ns.append(solution.linearise_ns)
    run.qp_ns.append(solution.qp_ns)
    run.step_norm.append(solution.step_norm)
    run.information.append(executed_gain(controller, run.measurement, z))
    run.cost.append(stage_cost(controller, solution))
    settings = controller.settings
    bounds = replace(bounds_of(settings, controller.knowledge.load_max, float(z[7])), tolerances=EXECUTED_TOLERANCE)
    knowledge = controller.knowledge
    phi = controller.phi_at(np.zeros(1))[:, 0]
    check = acceptance.AcceptanceCheck(controller.checked, knowledge.theta, phi, knowledge.brake_ratio)
    found = check(plan_of(solution, Roadside(controller.reference.line)), bounds).excess
    for name, tolerance in EXECUTED_TOLERANCE.items():
        run.violations[name] += bool(found[LIMITS.index(name), 1] > tolerance)


def executed_gain(controller: Controller, measurement: ca.Function, z: Array) -> float:
    """Delta I of Eq. (9) at an executed state, by the estimator's measurement model."""
    signals, kind = z[[3, 4, 5, 8, 7]], controller.settings.information.kind
    outputs: Any = measurement(signals, np.zeros(len(AUXILIARY)), controller.knowledge.mean, [])
    jacobian = outputs[1]
    std = np.array(measured_std(kind, controller.problem.model.vehicle.mass))
    return trace_criterion(fisher_information(np.array(jacobian)[None], std, controller.knowledge.prior_std))


def stage_cost(controller: Controller, solution: Solution) -> float:
    """Cost of the first stage of a solution without constants: the running cost of the closed loop."""
    w, z, du = controller.settings.weights, solution.z[:, 1], solution.du[:, 0]
    point = controller.reference.at(z[S : S + 1])
    cos, sin = np.cos(point.heading[0]), np.sin(point.heading[0])
    dx, dy = z[0] - point.x[0], z[1] - point.y[0]
    bounds = np.array(controller.problem.change_bounds())
    change = np.array([w.drive_change, w.steer_change, w.progress_change]) @ (du / bounds) ** 2
    contouring, lag = sin * dx - cos * dy, -cos * dx - sin * dy
    damping = w.lateral_speed * z[4] ** 2 + w.yaw_rate * z[5] ** 2
    progress = w.progress * z[PROGRESS]
    return float(w.contouring * contouring**2 + w.lag * lag**2 + damping + change - progress)


def percentiles(ns: list[int]) -> dict[str, float]:
    """p50, p99 and max of durations, ms."""
    p50, p99, top = np.percentile(np.array(ns) / 1e6, [50, 99, 100])
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4), "max": round(float(top), 4)}


def summary(run: Run, controller: Controller) -> dict[str, Any]:
    """The figures of `hil plan bench --json`."""
    solve = percentiles(run.solve_ns)
    ipopt = float(np.median(run.ipopt_ns)) / 1e6 if run.ipopt_ns else None
    lap = float(np.mean(run.lap_times_s)) if run.lap_times_s else None
    return {
        "laps": len(run.lap_times_s),
        "lap_time_s": lap,
        "lap_times_s": run.lap_times_s,
        "peak_speed": float(max(z[VX] for z in run.states)),
        "steps": len(run.states),
        "solve_ms": solve,
        "p99_over_p50": round(solve["p99"] / solve["p50"], 3),
        "linearise_ms": percentiles(run.linearise_ns),
        "qp_ms": percentiles(run.qp_ns),
        "sqp_iterations": controller.settings.iterations,
        "ipopt_warm_ms": {"p50": ipopt, "samples": len(run.ipopt_ns)},
        "speedup_vs_ipopt": round(ipopt / solve["p50"], 1) if ipopt else None,
        "violations": run.violations,
        "qp_failures": run.qp_failures,
        "information_per_s": float(np.mean(run.information)) / controller.settings.dt,
        "information_per_step": float(np.mean(run.information)),
        "information_bound": controller.settings.information.bound,
        "backend": controller.sqp.backend,
        "clock": "thread CPU time",
    }
