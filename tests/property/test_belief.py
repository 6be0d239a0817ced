"""The tyre belief keeps its promises whatever it is fed, and learns what an independent simulator hides."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.measurement_evaluation import MeasurementEvaluation
from support.promise_figures import record_figure, volume

from estimator.belief.information import a_criterion, d_criterion, e_criterion, fisher_information, trace_criterion
from estimator.belief.tyre_belief import BeliefSettings, Sample, TyreBelief
from estimator.model.measurement import CHANNELS, MeasurementKind, axle_forces
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY

UPDATES = volume(10_000, 1_000_000)
POINTS = volume(100, 1000)
AUX = np.zeros(len(AUXILIARY))
VEHICLE = load_car().vehicle


class Car:
    """Quasi-static single-track car written independently of the project's model: plain numpy, its own formulas."""

    def __init__(self, tyre: dict[str, float]) -> None:
        self.tyre = tyre

    def respond(self, signals: np.ndarray) -> np.ndarray:
        """ax, ay, yaw acceleration for vx, vy, yaw rate, steer, drive."""
        vx, vy, w, steer, drive = signals
        p, v = self.tyre, VEHICLE
        total = v.lf + v.lr
        front = steer - np.arctan((vy + v.lf * w) / vx)
        rear = -np.arctan((vy - v.lr * w) / vx)
        f = v.mass * GRAVITY * v.lr / total * p["df"] * np.sin(p["cf"] * np.arctan(p["bf"] * front))
        r = v.mass * GRAVITY * v.lf / total * p["dr"] * np.sin(p["cr"] * np.arctan(p["br"] * rear))
        ax = (p["cx"] * drive - f * np.sin(steer)) / v.mass
        ay = (r + f * np.cos(steer)) / v.mass
        return np.array([ax, ay, (f * v.lf * np.cos(steer) - r * v.lr) / v.yaw_inertia])


def random_signals(rng: np.random.Generator, limit: float = 0.12) -> np.ndarray:
    vx, slip_r = rng.uniform(20, 60), rng.uniform(-limit, limit)
    w = rng.uniform(-0.5, 0.5)
    vy = VEHICLE.lr * w - vx * np.tan(slip_r)
    steer = rng.uniform(-limit, limit) + np.arctan((vy + VEHICLE.lf * w) / vx)
    return np.array([vx, vy, w, steer, rng.uniform(-0.15, 0.1)])


def measured(kind: MeasurementKind, response: np.ndarray, steer: float) -> np.ndarray:
    return axle_forces(VEHICLE, *response, steer) if kind == "tyre_force" else response[: len(CHANNELS[kind])]


@pytest.mark.promise("N1")
def test_covariance_stays_psd_and_parameters_in_bounds_whatever_comes() -> None:
    rng = np.random.default_rng(11)
    belief = TyreBelief(
        SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")),
        BeliefSettings(drift=0.01),
    )
    table = belief.model.tyre_table
    lower, upper = np.array([p.lower for p in table]), np.array([p.upper for p in table])
    hostile = [np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0]
    for k in range(UPDATES):
        signals, z = rng.normal(0, [40, 10, 2, 0.5, 0.3]), rng.normal(0, 10 ** rng.uniform(-2, 6), 3)
        if rng.random() < 0.05:
            target = signals if rng.random() < 0.5 else z
            target[rng.integers(len(target))] = hostile[rng.integers(len(hostile))]
        belief.update(Sample(signals, np.diag(rng.uniform(0, 0.1, 3)), z, AUX))
        assert np.all((belief.mean >= lower - 1e-9 * abs(lower)) & (belief.mean <= upper * (1 + 1e-9)))
        if k % 100 == 0 or k == UPDATES - 1:
            P = belief.scaled_covariance
            assert np.array_equal(P, P.T)
            assert np.linalg.eigvalsh(P)[0] >= -1e-12
    assert belief.samples > UPDATES / 20, "the gates must not have refused everything"
    record_figure("N1", f"{UPDATES:,} hostile updates: symmetric, positive semi-definite, within bounds")


@pytest.mark.promise("N3")
@pytest.mark.parametrize("kind", ["imu_yaw", "tyre_force"])
def test_belief_is_consistent_with_known_truth_over_many_runs(kind: MeasurementKind) -> None:
    runs, samples, spread = volume(60, 200), 150, 0.08
    nees, nis = [], []
    for seed in range(runs):
        rng = np.random.default_rng([7, seed])
        belief = TyreBelief(
            SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")),
            BeliefSettings(kind=kind, correlation_samples=1.0),
        )
        belief.set_covariance(np.diag((spread * belief.scale) ** 2))
        truth = belief.prior + spread * belief.scale * rng.normal(size=7)
        car = Car(dict(zip(belief.names, truth, strict=True)))
        std = belief.settings.channel_std(load_car().vehicle.mass)
        for _ in range(samples):
            signals = random_signals(rng)
            z = measured(kind, car.respond(signals), signals[3]) + rng.normal(0, std)
            nis.extend(belief.update(Sample(signals, np.zeros((3, 3)), z, AUX)))
        error = (truth - belief.mean) / belief.scale
        nees.append(error @ np.linalg.solve(belief.scaled_covariance, error))
    low, high = stats.chi2.ppf([0.025, 0.975], 7 * runs) / runs
    assert low < np.mean(nees) < high
    low, high = stats.chi2.ppf([0.025, 0.975], len(nis)) / len(nis)
    assert low < np.mean(nis) < high
    record_figure("N3", f"belief ({kind}), {runs} runs: NEES {np.mean(nees):.2f} of 7, NIS {np.mean(nis):.3f}")


@pytest.mark.promise("N2")
@pytest.mark.parametrize("kind", ["imu", "imu_yaw", "tyre_force"])
@pytest.mark.parametrize("layout", ["shared", "per_axle"])
def test_measurement_jacobians_agree_with_finite_differences(kind: MeasurementKind, layout: str) -> None:
    rng = np.random.default_rng(5)
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), layout))
    h = MeasurementEvaluation(model, kind)
    prior = np.array([p.prior for p in model.tyre_table])
    for _ in range(POINTS):
        signals, theta = random_signals(rng), prior * rng.uniform(0.6, 1.6, len(prior))
        value, by_theta, by_signals = h(signals, AUX, theta)
        size = 1.0 + np.abs(value)[:, None]
        for analytic, point, at in (
            (by_theta, theta, lambda t, s=signals: h(s, AUX, t)[0]),
            (by_signals, signals, lambda s, t=theta: h(s, AUX, t)[0]),
        ):
            step = 1e-4 * np.maximum(np.abs(point), 1e-2)
            numeric = np.column_stack([fourth_order(at, point, i, step[i]) for i in range(len(point))])
            assert np.max(np.abs(numeric - analytic) * step / size) < 1e-9, "per step of 1e-4: 1e-5 relative"
            assert np.max(np.abs(numeric - analytic) * np.maximum(np.abs(point), 1e-2) / size) < 1e-6
    record_figure("N2", f"measurement Jacobians within 1e-6 of finite differences at {POINTS:,} points")


def fourth_order(f: object, x: np.ndarray, i: int, h: float) -> np.ndarray:
    e = np.zeros_like(x)
    e[i] = h
    return (8 * (f(x + e) - f(x - e)) - (f(x + 2 * e) - f(x - 2 * e))) / (12 * h)


@pytest.mark.promise("N2")
@pytest.mark.parametrize("kind", ["imu_yaw", "tyre_force"])
def test_left_right_mirror_is_exact(kind: MeasurementKind) -> None:
    rng = np.random.default_rng(6)
    h = MeasurementEvaluation(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")), kind)
    theta = np.array([p.prior for p in SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")).tyre_table])
    flip = np.array([1, -1, -1, -1, 1.0])
    for _ in range(1000):
        signals = random_signals(rng)
        left, right = h(signals, AUX, theta), h(signals * flip, AUX, theta)
        sides = np.array([1, -1, -1.0])
        assert np.array_equal(left[0] * sides, right[0])
        assert np.array_equal(left[1] * sides[:, None], right[1])


def test_independent_car_and_model_agree() -> None:
    rng = np.random.default_rng(8)
    h = MeasurementEvaluation(
        SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")),
        "imu_yaw",
    )
    tyre = dict(tyre_prior(load_car(), "per_axle"))
    for _ in range(50):
        signals = random_signals(rng)
        assert np.allclose(h(signals, AUX, np.array(list(tyre.values())))[0], Car(tyre).respond(signals), rtol=5e-3)


def test_belief_without_drift_equals_batch_information() -> None:
    """For a model linear in its parameters (C_x), Eq. (8) sums Eq. (7): posterior precision = prior + F."""
    belief = TyreBelief(
        SingleTrack(VEHICLE, tyre_prior(load_car(), "shared")),
        BeliefSettings(kind="imu", correlation_samples=1.0),
    )
    rng, jacobians = np.random.default_rng(2), []
    h = MeasurementEvaluation(belief.model, "imu")
    for _ in range(50):
        signals = np.array([30.0, 0.0, 0.0, 0.0, rng.uniform(0.02, 0.1)])
        jacobians.append(h(signals, AUX, belief.mean)[1][:1])
        belief.update(Sample(signals, np.zeros((3, 3)), np.array([signals[4] * 60.0, 0.0]), AUX))
    F = fisher_information(np.array(jacobians), belief.settings.channel_std(load_car().vehicle.mass)[:1], belief.scale)
    assert np.allclose(np.linalg.inv(belief.scaled_covariance), np.eye(4) + F, rtol=1e-9)
    assert belief.log_det_information == pytest.approx(d_criterion(np.eye(4) + F))


def test_criteria_order_informative_before_uninformative_driving() -> None:
    h = MeasurementEvaluation(
        SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")),
        "imu_yaw",
    )
    table = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")).tyre_table
    theta, scale = np.array([p.prior for p in table]), np.array([p.prior_std for p in table])
    std = BeliefSettings().channel_std(load_car().vehicle.mass)
    information = []
    for limit in (0.02, 0.12):
        rng = np.random.default_rng(4)
        jacobians = np.array([h(random_signals(rng, limit), AUX, theta)[1] for _ in range(200)])
        information.append(fisher_information(jacobians, std, scale))
    gentle, hard = information
    assert trace_criterion(hard) > trace_criterion(gentle)
    assert d_criterion(hard) > d_criterion(gentle)
    assert a_criterion(hard) < a_criterion(gentle)
    assert e_criterion(hard) > e_criterion(gentle)
    assert d_criterion(np.zeros((2, 2))) == -np.inf
    assert a_criterion(np.zeros((2, 2))) == np.inf


def test_nothing_is_learnt_at_rest_or_on_a_straight() -> None:
    belief = TyreBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
    for signals in ([0.0, 0, 0, 0.2, 0.1], [50.0, 0, 0, 0, 0]):
        belief.update(Sample(np.array(signals, dtype=float), np.zeros((3, 3)), np.ones(3), AUX))
    assert belief.samples == 0
    assert np.array_equal(belief.mean, belief.prior)


def test_uncertain_slip_teaches_less() -> None:
    signals, z = np.array([40.0, -1.0, 0.3, 0.08, 0.0]), np.array([0.0, 10.0, 0.0])
    gain = []
    for vy_std in (0.0, 2.0):
        belief = TyreBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
        belief.update(Sample(signals, np.diag([0.0, vy_std**2, 0.0]), z, AUX))
        gain.append(belief.log_det_information)
    assert gain[1] < 0.5 * gain[0]


def test_inputs_that_may_act_later_than_reported_teach_less() -> None:
    """A brake that comes 0.15 s late lacks all of its force where a stop begins: that is no weak brake."""
    signals, z = np.array([60.0, 0.0, 0.0, 0.0, -0.3]), np.array([0.0, 0.0, 0.0])
    moved = []
    for drive_std in (0.0, 0.15):
        belief = TyreBelief(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
        belief.update(Sample(signals, np.zeros((3, 3)), z, AUX, input_variance=(0.0, 15 * drive_std**2)))
        moved.append(abs(belief.mean[belief.names.index("cx")] - tyre_prior(load_car(), "per_axle")["cx"]))
    assert moved[0] > 0.0
    assert moved[1] < 0.2 * moved[0]
