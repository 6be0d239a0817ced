"""The Kalman predictor of the diagnosis against the joint distribution of a whole window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives.practice_drives import record_of, shared_drives

from estimator.offline.predict.innovations import Innovations
from estimator.offline.predict.propagate import Propagator
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import STATE_ROWS, Record

DRIFT = {"simulated": 0.0, "between": 0.3, "followed": 30.0}


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Record:
    """A few windows of a drive."""
    whole = record_of(shared_drives(tmp_path_factory)["flat"])
    return replace(whole, rows=whole.rows[:3, :12], lap=whole.lap[:3])


def joint_covariance(propagator: Propagator, start: np.ndarray, walk: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Covariance of the motion signals of one window, all blocks at once: each as a sum of its independent causes."""
    blocks = propagator.decay.shape[2]
    causes = 3 * (1 + blocks)
    state, rows = np.zeros((3, causes)), []
    state[:, :3] = np.diag(start)
    for b in range(blocks):
        rows.append(propagator.mean_decay[:, :, b, 0] @ state)
        state = propagator.decay[:, :, b, 0] @ state
        state[:, 3 * (b + 1) : 3 * (b + 2)] += np.diag(walk)
    stacked = np.concatenate(rows)
    return stacked @ stacked.T + np.diag(np.tile(noise**2, blocks))


@pytest.mark.parametrize("drift", DRIFT.values(), ids=DRIFT)
def test_innovations_have_the_likelihood_of_the_joint_distribution(record: Record, drift: float) -> None:
    rng = np.random.default_rng(7)
    windows, blocks = record.rows.shape[:2]
    state_by = rng.normal(scale=2.0, size=(5, 3, windows, blocks))
    propagator = Propagator.make(state_by, record.block_step)
    noise = ResidualNoise(2.0 * record.block_noise, np.array([0.0, 0.0, drift, drift, drift]))
    innovations = Innovations.make(record, propagator, noise)
    measured = rng.normal(scale=0.01, size=(blocks, windows, 3))
    inputs = np.zeros((blocks, windows, 11, 1))
    inputs[:, :, 8:, 0] = measured
    white = innovations.run(inputs)[:, 0, STATE_ROWS, 0] / innovations.scale[STATE_ROWS]
    own = noise.deviation[STATE_ROWS]
    covariance = joint_covariance(propagator, 4.0 * record.state_error, np.sqrt(drift) * own, own)
    flat = measured[:, 0].ravel()
    assert np.sum((white / own) ** 2) == pytest.approx(flat @ np.linalg.solve(covariance, flat), rel=1e-9)


def test_a_signal_that_is_not_used_changes_nothing(record: Record) -> None:
    blind = replace(record, used=np.array([True, True, False, True, False]))
    windows, blocks = record.rows.shape[:2]
    state_by = np.random.default_rng(8).normal(size=(5, 3, windows, blocks))
    propagator = Propagator.make(state_by, record.block_step)
    innovations = Innovations.make(blind, propagator, ResidualNoise.white(record.block_noise))
    inputs = np.zeros((blocks, windows, 11, 1))
    inputs[:, :, [9, 10]] = 1.0
    out = innovations.run(inputs)
    assert np.all(out[:, :, [2, 4]] == 0.0)
    assert np.max(np.abs(out)) < 1e-6
