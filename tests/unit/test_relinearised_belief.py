"""The belief that linearises its history again is honest where Eq. (8) alone is sure of the wrong tyre."""

from __future__ import annotations

from itertools import cycle, islice

import numpy as np
import pytest

from estimator.model.measurement import measurement_function
from estimator.model.parameters import DEFAULT_TYRE
from estimator.model.single_track import AUXILIARY, SingleTrack
from estimator.relinearised_belief import CAPACITY, RelinearisedBelief
from estimator.tyre_belief import BeliefSettings, Sample, TyreBelief
from hil_gateway.vehicle import Vehicle

VEHICLE = Vehicle()
AUX = np.zeros(len(AUXILIARY))
PRIOR = np.array(list(DEFAULT_TYRE["per_axle"].values()))
SLIP_COVARIANCE = np.diag([0.01, 0.01, 0.001]) ** 2


def laps_below_the_limit(truth: np.ndarray, count: int, seed: int, slip: float = 0.07) -> list[Sample]:
    """Samples of slaloms at slips far from the tyre's peak (0.26 rad), measured with the noise the belief expects."""
    rng = np.random.default_rng(seed)
    k = np.arange(count)
    vx, front, rear = 35.0 + 15.0 * np.sin(k / 700), slip * np.sin(k / 50), 0.9 * slip * np.sin(k / 50 - 0.3)
    rate = 0.3 * np.sin(k / 50)
    vy = VEHICLE.lr * rate - vx * np.tan(rear)
    steer = front + np.arctan((vy + VEHICLE.lf * rate) / vx)
    signals = np.column_stack([vx, vy, rate, steer, 0.05 * np.sin(k / 90)])
    h = measurement_function(SingleTrack(VEHICLE, "per_axle"), "imu_yaw")
    z = np.array(h(signals.T, AUX[:, None], truth, np.zeros((0, 1)))[0]).T
    std = BeliefSettings().channel_std()
    # errors of one half second are one error: that is what `correlation_samples` says
    noise = np.repeat(rng.normal(0.0, std / np.sqrt(50.0), (count // 50 + 1, 3)), 50, axis=0)[:count]
    return [Sample(s, SLIP_COVARIANCE, m, AUX) for s, m in zip(signals, z + noise, strict=True)]


def learnt(belief: TyreBelief, samples: list[Sample]) -> TyreBelief:
    for sample in samples:
        belief.update(sample)
    return belief


def nees(belief: TyreBelief, truth: np.ndarray) -> float:
    error = belief.mean - truth
    return float(error @ np.linalg.solve(belief.covariance, error))


def test_far_from_the_peak_the_truth_stays_within_the_belief() -> None:
    found: dict[type[TyreBelief], list[float]] = {RelinearisedBelief: [], TyreBelief: []}
    for seed in range(5):
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], 6)
        truth = PRIOR * np.array([1.0, *(1.0 + 0.1 * signs)])
        samples = laps_below_the_limit(truth, 3000, seed)
        for kind, values in found.items():
            values.append(nees(learnt(kind(SingleTrack(VEHICLE, "per_axle")), samples), truth))
    assert np.median(found[RelinearisedBelief]) < 14.07, "95 % of chi squared with 7 degrees of freedom"
    assert np.mean(found[TyreBelief]) > 3 * np.mean(found[RelinearisedBelief]), (
        "Eq. (8) alone was sure of the wrong tyre"
    )


def test_covariance_is_the_information_at_the_mean_it_goes_with() -> None:
    truth = PRIOR * np.array([1.0, 1.1, 0.9, 1.1, 1.1, 0.9, 1.1])
    samples = laps_below_the_limit(truth, 2000, seed=4)
    belief = learnt(RelinearisedBelief(SingleTrack(VEHICLE, "per_axle")), samples)
    h = measurement_function(belief.model, "imu_yaw")
    information = np.eye(7)
    for sample in samples:
        H = np.array(h(sample.signals, AUX, belief.mean, np.zeros((0, 1)))[1]) * belief.scale
        active = belief._active_channels(sample)
        information += H.T @ (H * (active / belief.channel_variance)[:, None])
    assert belief.log_det_information == pytest.approx(np.linalg.slogdet(information)[1], rel=0.05)


def test_memory_is_bounded_and_old_samples_keep_their_weight() -> None:
    samples = laps_below_the_limit(PRIOR, 500, seed=5)
    once = learnt(RelinearisedBelief(SingleTrack(VEHICLE, "per_axle")), (samples * 4)[:2000])
    many = learnt(RelinearisedBelief(SingleTrack(VEHICLE, "per_axle")), list(islice(cycle(samples), 16_000)))
    assert len(many._history) < CAPACITY
    assert many._thinning > once._thinning
    # eight times the data: a direction known from data alone gains log 8
    gain = np.log(np.linalg.eigvalsh(once.scaled_covariance)[0] / np.linalg.eigvalsh(many.scaled_covariance)[0])
    assert gain == pytest.approx(np.log(8.0), rel=0.15)


def test_reset_forgets_the_history() -> None:
    belief = RelinearisedBelief(SingleTrack(VEHICLE, "per_axle"))
    learnt(belief, laps_below_the_limit(1.1 * PRIOR, 1000, seed=6))
    belief.reset()
    samples = laps_below_the_limit(PRIOR, 300, seed=6)
    fresh = learnt(RelinearisedBelief(SingleTrack(VEHICLE, "per_axle")), samples)
    assert np.array_equal(learnt(belief, samples).mean, fresh.mean)


def test_a_start_from_a_known_covariance_is_not_forgotten() -> None:
    belief = RelinearisedBelief(SingleTrack(VEHICLE, "per_axle"))
    belief.set_covariance(np.diag((1e-4 * PRIOR) ** 2))
    learnt(belief, laps_below_the_limit(1.1 * PRIOR, 1000, seed=7))
    assert belief.mean == pytest.approx(PRIOR, rel=1e-3)
    assert np.all(np.sqrt(np.diag(belief.covariance)) < 1.01e-4 * PRIOR)
