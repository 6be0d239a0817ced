"""Laps on the simulated car with a model that is wrong: are all limits kept?

The planner's tyre parameters are each off by a stated share, with random signs, and are not corrected while
driving. What is counted: wheels off the track (referee), load limits and information bound at the state every plan
starts from, commands outside their range, plans that were not fresh solutions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from estimator.belief.revision import declared_revision
from estimator.model.parameters import tyre_prior
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import Command, Plan, PlanStatus
from hil_gateway.bus.topics import COMMAND, PLAN
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.plant.plant import plant_parameters
from hil_gateway.plant.referee.lap_limit import lap_limit, lap_ratios
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.node import Planner
from planner.simulation.loop import Loop

LOAD_TOLERANCE = 0.05
INFORMATION_TOLERANCE = 0.02


@dataclass
class Watch:
    """Figures of every plan of a drive."""

    front: list[float] = field(default_factory=list)
    rear: list[float] = field(default_factory=list)
    gain: list[float] = field(default_factory=list)
    progress: list[tuple[float, float]] = field(default_factory=list)
    """time, s, and place along the race line, m, of every plan"""


def mismatched_tyre(config: Config, share: float, seed: int) -> dict[str, float]:
    """Declared tyre parameters, each off by `share` up or down."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=len(tyre_prior(load_car(), config.estimator.layout)))
    values = tyre_prior(load_car(), config.estimator.layout).items()
    return {name: value * (1.0 + share * sign) for (name, value), sign in zip(values, signs, strict=True)}


def drive(config: Config, laps: int, mismatch: float, seed: int, track: Track | None = None) -> dict[str, Any]:
    """Drive `laps` laps from a standing start and count violations.

    Returns the figures of `hil plan safety --json`.
    """
    watch = Watch()
    tyre = mismatched_tyre(config, mismatch, seed)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        path.write_text(declared_revision(tyre).model_dump_json())
        wrong = config.model_copy(update={
            "planner": config.planner.model_copy(update={"model": str(path)}),
            "estimator": config.estimator.model_copy(update={"model": str(path), "learn": False}),
        })  # fmt: skip

        def watched(config: Config, bus: Bus, track: Track | None = None) -> Watched:
            return Watched(config, bus, track, watch)

        loop = Loop(wrong, keep=(PLAN, COMMAND), track=track, components={"planner": watched})
        result = loop.run(laps=laps, time_limit_s=200.0 * laps + 60.0)
    limit_s = lap_limit(plant_parameters(config.plant), track or load_track(config.track)).limit_s
    plans = [p for p in result.messages[PLAN.key] if isinstance(p, Plan)]
    commands = [c for c in result.messages[COMMAND.key] if isinstance(c, Command)]
    return {
        "laps": result.laps,
        "lap_times_s": [round(t, 3) for t in result.lap_times_s],
        "limit_s": limit_s,
        "lap_ratio": lap_ratios(result.lap_times_s, limit_s),
        "friction_used": dict(zip(("front", "rear"), result.friction_used, strict=True)),
        "friction_over_s": result.friction_over_s,
        "spins": result.spins,
        "peak_speed": result.peak_speed,
        "mismatch": mismatch,
        "information_weight": config.planner.information_weight,
        "plans": len(plans),
        "plans_not_fresh": sum(p.status is not PlanStatus.SOLVED for p in plans),
        "reasons": sorted({p.reason.split(":")[0] + p.reason.split(":")[1][:12] for p in plans if ":" in p.reason}),
        "failsafes": len(result.failsafes),
        "worst_margin_m": result.worst_margin_m,
        "load_share_max": {"front": max(watch.front), "rear": max(watch.rear)},
        "violations": violations(config, watch, commands, result.off_track),
    }


def violations(config: Config, watch: Watch, commands: list[Command], off_track: int) -> dict[str, int]:
    """Counts by kind."""
    from planner.problem.settings import settings_of

    limits, bound = settings_of(config).limits, config.planner.information_bound
    loads = np.maximum(watch.front, watch.rear)
    outside = [abs(c.steer) > limits.steer or not limits.drive_min <= c.drive <= limits.drive_max for c in commands]
    gains = np.array(watch.gain) if config.planner.information_weight > 0 else np.zeros(1)
    return {
        "track": off_track,
        "load": int(np.sum(loads > 1.0 + LOAD_TOLERANCE)),
        "actuator": int(np.sum(outside)),
        "information": int(np.sum(gains > (1.0 + INFORMATION_TOLERANCE) * bound)),
    }


class Watched(Planner):
    """The planner, noting the loads and the information of every plan's start."""

    def __init__(self, config: Config, bus: Bus, track: Track | None, watch: Watch) -> None:
        super().__init__(config, bus, track)
        self._watch = watch

    def step(self, now_ns: int) -> Plan | None:
        """See `Planner.step`."""
        plan = super().step(now_ns)
        if plan is not None:
            self._watch.progress.append((now_ns / NS_PER_S, plan.s[0]))
        if plan is not None and plan.status is PlanStatus.SOLVED:
            front, rear = self.fresh.check.first_loads
            self._watch.front.append(front)
            self._watch.rear.append(rear)
            self._watch.gain.append(self.fresh.check.first_gain)
        return plan
