"""Violations of a campaign's drives, and loads by the true tyres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.plans.safety import LOAD_TOLERANCE, Watch
from estimator.belief.tyre_belief import Sample
from estimator.model.parameters import layout_of, tyre_prior
from estimator.model.tyre import front_and_rear, normalised_force, slip_at_peak
from hil_gateway.car.car import load_car
from hil_gateway.process.arrays import Array
from planner.simulation.loop import LoopResult

SLIP_SPEED = 10.0
"""m/s"""


def safety_figures(
    result: LoopResult, watch: Watch, kept: list[Sample], tyre: Mapping[str, float],
    limits: tuple[float, float],
) -> dict[str, Any]:  # fmt: skip
    """Violations: off track by the referee, loads over the run's limits and slip beyond the peak by the true tyres.

    `load_by_model` counts as `hil plan safety` does, with the tyres the planner believes in at that moment.
    """
    loads, slips = np.maximum(watch.front, watch.rear), slip_shares(kept, tyre)
    true_loads = load_shares(kept, tyre, limits)
    return {
        "laps": result.laps,
        "off_track": result.off_track,
        "worst_margin_m": result.worst_margin_m,
        "load_violations": int(np.sum(true_loads > 1.0 + LOAD_TOLERANCE)),
        "load_by_model": int(np.sum(loads > 1.0 + LOAD_TOLERANCE)),
        "worst_load_share": float(loads.max(initial=0.0)),
        "worst_true_load_share": float(true_loads.max(initial=0.0)),
        "traction_lost": int(np.sum(slips > 1.0)),
        "worst_slip_share": float(slips.max(initial=0.0)),
        "plan_failures": result.plan_failures,
        "failsafes": [list(entry) for entry in result.failsafes],
    }


def load_shares(kept: list[Sample], tyre: Mapping[str, float], limits: tuple[float, float]) -> Array:
    """Force of either axle over its load limit at every kept sample, shape (2 K,) at most, with the true tyres.

    `limits` are over static axle load. At walking speed a slip angle is mostly sensor noise: those samples are left
    out.
    """
    if not kept:
        return np.zeros(0)
    slip_f, slip_r, drive = _slips(kept)
    axles = front_and_rear(layout_of(tyre))
    front, rear = (normalised_force(slip, *axle.of(tyre)) for slip, axle in zip((slip_f, slip_r), axles, strict=True))
    along = tyre_prior(load_car(), "per_axle")["cx"] * drive / load_car().vehicle.static_load_rear
    return np.concatenate([np.abs(front) / limits[0], np.hypot(rear, along) / limits[1]])


def slip_shares(kept: list[Sample], tyre: Mapping[str, float]) -> Array:
    """Slip angle of either axle over that of the true tyre's peak, shape (2 K,) at most: above 1 traction is lost."""
    if not kept:
        return np.zeros(0)
    slip_f, slip_r, _ = _slips(kept)
    return np.concatenate([
        np.abs(slip) / slip_at_peak(*axle.of(tyre)[:2])
        for slip, axle in zip((slip_f, slip_r), front_and_rear(layout_of(tyre)), strict=True)
    ])  # fmt: skip


def _slips(kept: list[Sample]) -> tuple[Array, Array, Array]:
    """Slip angles, rad, and drive command of the samples above `SLIP_SPEED`."""
    v = load_car().vehicle
    signals = np.array([sample.signals for sample in kept])
    vx, vy, rate, steer, drive = signals[signals[:, 0] > SLIP_SPEED].T
    return steer - np.arctan2(vy + v.lf * rate, vx), -np.arctan2(vy - v.lr * rate, vx), drive
