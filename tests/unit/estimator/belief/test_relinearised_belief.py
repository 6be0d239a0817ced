"""The belief that linearises its history again is honest where Eq. (8) alone is sure of the wrong tyre."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.belief.relinearised import CAPACITY, RelinearisedBelief, _Stacked
from estimator.belief.tyre_belief import BeliefSettings, Sample, TyreBelief
from estimator.model.measurement import measurement_function
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.car.car import load_car

VEHICLE = load_car().vehicle
AUX = np.zeros(len(AUXILIARY))
PRIOR = np.array(list(tyre_prior(load_car(), "per_axle").values()))
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
    h = measurement_function(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")), "imu_yaw")
    z = np.array(h(signals.T, AUX[:, None], truth, np.zeros((0, 1)))[0]).T
    std = BeliefSettings().channel_std(load_car().vehicle.mass)
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
            values.append(nees(learnt(kind(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples), truth))
    assert np.median(found[RelinearisedBelief]) < 14.07, "95 % of chi squared with 7 degrees of freedom"
    assert np.mean(found[TyreBelief]) > 3 * np.mean(found[RelinearisedBelief]), (
        "Eq. (8) alone was sure of the wrong tyre"
    )


def test_all_of_the_history_is_modelled_as_each_sample_is() -> None:
    samples = laps_below_the_limit(PRIOR, 40, seed=6)
    belief = RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
    theta = PRIOR * np.linspace(0.9, 1.1, len(PRIOR))
    together = _Stacked(belief._model, samples, np.ones((40, 3))).modelled(theta)
    for k, sample in enumerate(samples):
        belief._predict_sample(sample, (theta - belief.prior) / belief.scale)
        belief._model.arguments[2][:] = theta
        belief._model()
        for alone, found in zip(belief._model.outputs, together, strict=True):
            columns = alone.shape[1]
            np.testing.assert_array_equal(found[:, k * columns : (k + 1) * columns], alone)


def test_covariance_is_the_information_at_the_mean_it_goes_with() -> None:
    truth = PRIOR * np.array([1.0, 1.1, 0.9, 1.1, 1.1, 0.9, 1.1])
    samples = laps_below_the_limit(truth, 2000, seed=4)
    belief = learnt(RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples)
    h = measurement_function(belief.model, "imu_yaw")
    information = np.eye(7)
    for sample in samples:
        H = np.array(h(sample.signals, AUX, belief.mean, np.zeros((0, 1)))[1]) * belief.scale
        active = belief._active_channels(sample)
        information += H.T @ (H * (active / belief.channel_variance)[:, None])
    assert belief.log_det_information == pytest.approx(np.linalg.slogdet(information)[1], rel=0.05)


def test_memory_is_bounded_and_old_samples_keep_their_weight() -> None:
    samples = laps_below_the_limit(PRIOR, 16_000, seed=5)
    once = learnt(RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples[:2000])
    many = learnt(RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples)
    assert len(many._history) < CAPACITY
    assert many._thinning > once._thinning
    # eight times the data; a sample of the thinned history counts for one independent one at most
    held = len(many._history) / (2000 / BeliefSettings().correlation_samples)
    gain = np.log(np.linalg.eigvalsh(once.scaled_covariance)[0] / np.linalg.eigvalsh(many.scaled_covariance)[0])
    assert 0.6 * np.log(held) < gain < 1.15 * np.log(held)


def with_less_force_when_driven(samples: list[Sample]) -> list[Sample]:
    """What a friction ellipse does and Eq. (2) leaves out: a tenth less lateral force for half of each drive cycle."""
    return [s._replace(z=s.z * [1.0, 0.9 if s.signals[4] > 0.0 else 1.0, 1.0]) for s in samples]


def test_errors_that_keep_their_sign_count_less(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = PRIOR * np.array([1.0, 1.1, 0.9, 1.1, 1.1, 0.9, 1.1])
    samples = with_less_force_when_driven(laps_below_the_limit(truth, 12_000, seed=8))
    honest = learnt(RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples)
    monkeypatch.setattr(RelinearisedBelief, "_dependence", lambda self, residual, H, weight: np.ones(3))
    credulous = learnt(RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples)
    assert nees(credulous, truth) > 2 * nees(honest, truth)
    assert np.max(np.abs(honest.mean / truth - 1.0)) < np.max(np.abs(credulous.mean / truth - 1.0))


def test_a_stiffer_car_is_learnt_in_its_first_bend() -> None:
    """Errors of one sign that other parameters explain are no reason to count samples less."""
    truth = PRIOR * np.array([1.0, 1.25, 1.05, 1.25, 1.25, 1.05, 1.25])
    straight = laps_below_the_limit(truth, 1000, seed=3, slip=0.006)
    bend = [s for s in laps_below_the_limit(truth, 1200, seed=3, slip=0.04) if s.z[1] > 0.0][:300]
    belief = RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
    belief.set_covariance(np.diag((0.1 * PRIOR) ** 2))
    learnt(belief, [*straight, *bend])
    h = measurement_function(belief.model, "imu_yaw")
    felt = np.array([s.z[1] for s in bend])
    told = np.array([float(h(s.signals, AUX, belief.mean, np.zeros((0, 1)))[0][1]) for s in bend])
    assert told @ felt == pytest.approx(felt @ felt, rel=0.08)


def test_between_two_linearisations_the_jacobians_do_not_turn_with_the_mean() -> None:
    belief = learnt(
        RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))),
        laps_below_the_limit(PRIOR, 3000, seed=9),
    )
    at, before = belief.mean, np.linalg.inv(belief.scaled_covariance)
    bend = max(laps_below_the_limit(1.2 * PRIOR, 200, seed=9), key=lambda s: abs(s.z[1]))
    learnt(belief, [bend] * 60)
    assert np.max(np.abs(belief.mean / at - 1.0)) > 0.01, "nothing was learnt"
    H = (
        np.array(measurement_function(belief.model, "imu_yaw")(bend.signals, AUX, at, np.zeros((0, 1)))[1])
        * belief.scale
    )
    expected = before + 60 * H.T @ (H / belief.channel_variance[:, None])
    assert belief.log_det_information == pytest.approx(np.linalg.slogdet(expected)[1], abs=0.3)


def test_reset_forgets_the_history() -> None:
    belief = RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
    learnt(belief, laps_below_the_limit(1.1 * PRIOR, 1000, seed=6))
    belief.reset()
    samples = laps_below_the_limit(PRIOR, 300, seed=6)
    fresh = learnt(RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))), samples)
    assert np.array_equal(learnt(belief, samples).mean, fresh.mean)


def test_a_start_from_a_known_covariance_is_not_forgotten() -> None:
    belief = RelinearisedBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
    belief.set_covariance(np.diag((1e-4 * PRIOR) ** 2))
    learnt(belief, laps_below_the_limit(1.1 * PRIOR, 1000, seed=7))
    assert belief.mean == pytest.approx(PRIOR, rel=1e-3)
    assert np.all(np.sqrt(np.diag(belief.covariance)) < 1.01e-4 * PRIOR)
