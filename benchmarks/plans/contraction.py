"""Does bounding Delta I make the planner contract? Two measured ratios, with and without the bound of Eq. (9).

Iterations: |step_{j+1}| / |step_j| of successive SQP steps from one state; below 1 the method contracts towards its
fixed point. Trajectories: distance of two closed-loop drives that start apart, over the distance they started with,
in units of `SCALE`; below 1 the closed loop forgets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.plans.bench import bench_controller, clock, start_state
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.track.loading import load_track
from planner.plan.controller import Controller
from planner.problem.motion import S
from planner.problem.settings import Information, declared_settings

SCALE = np.array([1.0, 1.0, 0.05, 1.0, 0.5, 0.1])
"""m, m, rad, m/s, m/s, rad/s: what counts as one unit of distance between states of the car"""
ITERATIONS = 6
PLACES = 24
SECONDS = 2.0
WEIGHT = 0.03
"""q_I of the cases with information, three times that of `hil plan bench`: the bound has to act"""
CASES = {
    "plain": Information(),
    "infomax, bound far away": Information(weight=WEIGHT, bound=1e9),
    "infomax, bound 400": Information(weight=WEIGHT, bound=400.0),
    "infomax, bound 200": Information(weight=WEIGHT, bound=200.0),
}
NEGLIGIBLE = 1e-3
"""steps below this share of the input bounds are numerical noise of the QP solver's tolerance"""


@dataclass(frozen=True)
class Contraction:
    """Ratios at places around the lap: of successive SQP steps, and of neighbouring drives after `SECONDS`."""

    iterations: Array
    trajectories: Array

    def summary(self) -> dict[str, Any]:
        """Median, 90 % point and share below 1 of both ratios."""
        return {name: _describe(getattr(self, name)) for name in ("iterations", "trajectories")}


def _describe(ratios: Array) -> dict[str, float]:
    return {
        "median": round(float(np.median(ratios)), 3),
        "p90": round(float(np.percentile(ratios, 90)), 3),
        "share_below_1": round(float(np.mean(ratios < 1.0)), 3),
        "samples": len(ratios),
    }


def compare(config: Config, places: int = PLACES) -> dict[str, Any]:
    """Summaries of `CASES` on the configured track: the object of `hil plan contraction --json`."""
    track, result = load_track(config.track), {}
    for name, information in CASES.items():
        settings = replace(
            declared_settings(load_car()), information=replace(information, kind=config.estimator.measurement)
        )
        controller, _ = bench_controller(track, config.vehicle, settings)
        result[name] = measure(controller, places).summary()
    return {"places": places, "seconds": SECONDS, "cases": result}


def measure(controller: Controller, places: int = PLACES, seed: int = 0) -> Contraction:
    """Both ratios at `places` places around the lap."""
    rng = np.random.default_rng(seed)
    iterations: list[float] = []
    trajectories: list[float] = []
    for s in np.arange(places) * controller.reference.length / places:
        z = _settled(controller, float(s))
        apart = z.copy()
        apart[:6] += 0.5 * SCALE * rng.standard_normal(6) * np.array([1, 1, 0.3, 1, 0.3, 0.3])
        iterations += step_ratios(controller, apart)
        trajectories.append(_drive_apart(controller, z, apart))
    return Contraction(np.array(iterations), np.array(trajectories))


def _settled(controller: Controller, s: float) -> Array:
    """A state reached by driving half a second from the race line."""
    z = start_state(controller, s)
    controller.cold_start(z, clock)
    for _ in range(10):
        controller.solve(z, clock)
        z = _advance(controller, z)
    return z


def _advance(controller: Controller, z: Array) -> Array:
    after = controller.sqp.propagate(z, controller.sqp.du[:, 0], controller.stages[:, 0], controller.common)
    controller.shift()
    return after


def step_ratios(controller: Controller, z: Array) -> list[float]:
    """|step_{j+1}| / |step_j| of SQP iterations at state `z`, while the steps are more than noise."""
    guess = controller.sqp.z.copy(), controller.sqp.du.copy()
    norms = [controller.solve(z, clock, 1).step_norm for _ in range(ITERATIONS)]
    controller.sqp.set_guess(*guess)
    return [b / a for a, b in pairwise(norms) if a > NEGLIGIBLE]


def _drive_apart(controller: Controller, first: Array, second: Array) -> float:
    """Distance of two drives after `SECONDS` over the distance at their start, at equal progress."""
    guess = controller.sqp.z.copy(), controller.sqp.du.copy()
    ends = []
    for start in (first, second):
        controller.sqp.set_guess(guess[0].copy(), guess[1].copy())
        z, path = start, [start]
        for _ in range(round(SECONDS / controller.settings.dt) + 10):
            controller.solve(z, clock)
            z = _advance(controller, z)
            path.append(z)
        ends.append(np.array(path))
    controller.sqp.set_guess(*guess)
    goal = min(path[round(SECONDS / controller.settings.dt), S] for path in ends)
    a, b = (np.array([np.interp(goal, path[:, S], path[:, i]) for i in range(6)]) for path in ends)
    return float(np.linalg.norm((a - b) / SCALE) / np.linalg.norm((first - second)[:6] / SCALE))
