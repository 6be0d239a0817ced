"""Full nonlinear fit of 180,000 samples against scipy's least_squares on the same model, in one run.

The peer is the same residual in vectorised numpy with numerical derivatives. Run: python -m benchmarks.identify
"""

from __future__ import annotations

import json
import resource
import time
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from estimator.drive_log.table import DriveLog, segment_numbers
from estimator.model.columns import CHANNELS, ModelColumns
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from estimator.model.tyre import blend_speed
from estimator.offline.fit.equation_error import fit
from estimator.offline.fit.problem import FitSettings
from estimator.offline.fit.recursive import averaged, batch
from estimator.offline.record.prepare import Samples, prepare
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

SAMPLES = 180_000
CHOSEN = ("ax", "ay", "yaw_acc")
TYRE = np.array([62000.0, 11.5, 1.55, 1.6, 13.0, 1.6, 1.58])


def predicted(theta: Array, inputs: Array, vehicle: Vehicle) -> Array:
    """ax, ay, yaw acceleration (3, n) of Eq. 1-3 in plain numpy."""
    vx, vy, yaw_rate, steer, drive = inputs[:5]
    cx, bf, cf, df, br, cr, dr = theta
    speed = np.sqrt(np.sqrt(vx**4 + blend_speed(vehicle) ** 4))
    front = steer - np.arctan((vy + vehicle.lf * yaw_rate) / speed)
    rear = -np.arctan((vy - vehicle.lr * yaw_rate) / speed)
    fyf = df * vehicle.static_load_front * np.sin(cf * np.arctan(bf * front))
    fyr = dr * vehicle.static_load_rear * np.sin(cr * np.arctan(br * rear))
    yaw_acc = (fyf * vehicle.lf * np.cos(steer) - fyr * vehicle.lr) / vehicle.yaw_inertia
    ax, ay = (cx * drive - fyf * np.sin(steer)) / vehicle.mass, (fyr + fyf * np.cos(steer)) / vehicle.mass
    return np.stack([ax, ay, yaw_acc])


def synthetic(columns: ModelColumns) -> Samples:
    """180,000 samples of hard and gentle cornering with the noise of a good sensor set."""
    rng = np.random.default_rng(0)
    t = np.arange(SAMPLES) / 100.0
    waves = [np.sin(2 * np.pi * f * t + p) for f, p in zip((0.05, 0.11, 0.23, 0.31), rng.uniform(0, 6, 4), strict=True)]
    vx = 35.0 + 12.0 * waves[0]
    alpha_f, alpha_r = 0.06 * waves[1] + 0.02 * waves[3], 0.05 * waves[1] + 0.02 * waves[2]
    yaw_rate = 9.0 * np.tanh(25 * alpha_r) / vx
    vy = vx * np.tan(-alpha_r) + 1.248 * yaw_rate
    steer = alpha_f + np.arctan((vy + 1.724 * yaw_rate) / vx)
    drive = 0.06 * waves[2]
    names = {"t": t, "vx": vx, "vy": vy, "yaw_rate": yaw_rate, "steer": steer, "drive": drive}
    log = DriveLog(
        {**names, "ax": rng.standard_normal(SAMPLES), "ay": rng.standard_normal(SAMPLES)}, segment_numbers(t)
    )
    samples = prepare(log, smooth=False)
    noise = np.array([0.15, 0.15, 0.1])[:, None] * rng.standard_normal((3, len(samples)))
    samples.channels[:3] = columns.predict(samples.inputs, TYRE, CHOSEN) + noise
    return samples


def by_scipy(samples: Samples, columns: ModelColumns, spread: Array) -> tuple[Array, float]:
    """scipy least_squares with numerical derivatives on the same scaled parameters and loss: (theta, seconds)."""
    vehicle = columns.model.vehicle
    prior = np.array([p.prior for p in columns.parameters])
    scale = np.array([p.prior_std for p in columns.parameters])
    measured = samples.channels[[CHANNELS.index(c) for c in CHOSEN]]

    def errors(u: Array) -> Array:
        z = (measured - predicted(prior + scale * u, samples.inputs, vehicle)) / spread[:, None]
        return np.concatenate([z.ravel(), u])

    began = time.process_time()
    solution = least_squares(errors, np.zeros(len(prior)), method="trf", loss="huber", f_scale=3.0)
    return prior + scale * solution.x, time.process_time() - began


def main() -> None:
    """Print one JSON object."""
    vehicle = load_car().vehicle
    columns = ModelColumns(SingleTrack(vehicle, tyre_prior(load_car(), "per_axle")))
    samples = synthetic(columns)
    fit(columns, samples.select_range(0, 1000))  # builds the functions
    began = time.process_time()
    ours = fit(columns, samples, FitSettings())
    ours_s = time.process_time() - began
    began = time.process_time()
    batch(columns, averaged(samples), averaged(samples).select_range(0, 2000))
    batch_s = time.process_time() - began
    memory_before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    theta, scipy_s = by_scipy(samples, columns, np.array([ours.spread[c] for c in CHOSEN]))
    result: dict[str, Any] = {
        "samples": len(samples),
        "nls_s": round(ours_s, 3),
        "scipy_s": round(scipy_s, 3),
        "ratio": round(scipy_s / ours_s, 1),
        "same_optimum": float(np.max(np.abs(theta - ours.theta) / np.array(list(ours.std.values())))),
        "batch_s": round(batch_s, 3),
        "peak_memory_mb": round(memory_before / 1024),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
