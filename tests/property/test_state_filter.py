"""The state filter against an independent simulator: consistent, aligned from motion, robust to bad sensors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.promise_figures import record_figure, volume

from estimator.state.filter_steps import (
    BIAS_AX,
    BIAS_AY,
    HEADING_TURN,
    IMU_AHEAD,
    IMU_TURN,
    STATES,
    VX,
    VY,
    YAW,
    FilterNoise,
    filter_car,
)
from estimator.state.state_filter import ImuReading, StateFilter
from hil_gateway.car.car import load_car

DT, FINE = 0.01, 10
HEADING_STD = 0.0014
"""rad that a receiver states"""
CAR = filter_car(load_car(), next(iter(load_car().receivers.values())))
NOISE = FilterNoise(initial_yaw=0.1)
"""Consistency is a promise about the aligned filter: a linearised one has no 95 % band for a heading 1 rad off."""


class Drive:
    """Smooth random motion over hills and its sensors; kinematics at 1 kHz, independent of the filter."""

    def __init__(
        self, rng: np.random.Generator, seconds: float, noise: FilterNoise = NOISE, *, ahead: float | None = None
    ) -> None:  # fmt: skip
        t = np.arange(round(seconds / DT) * FINE + 1) * DT / FINE
        self.vx = rng.uniform(20, 40) + self._waves(rng, t, 6.0, 0.3)
        self.vy = self._waves(rng, t, 0.7, 1.0)
        rate = self._waves(rng, t, 0.35, 1.0)
        yaw = rng.uniform(-np.pi, np.pi) + self._integral(rate, t)
        x = self._integral(self.vx * np.cos(yaw) - self.vy * np.sin(yaw), t)
        y = self._integral(self.vx * np.sin(yaw) + self.vy * np.cos(yaw), t)
        ax, ay = np.gradient(self.vx, t) - self.vy * rate, np.gradient(self.vy, t) + self.vx * rate
        n = len(t) // FINE
        self.gravity = np.column_stack([self._waves(rng, t, 1.0, 0.2)[::FINE] for _ in range(2)])
        accel_std = np.hypot(CAR.accel, noise.accel_model)
        walk = np.array([
            noise.bias_accel_walk, noise.bias_accel_walk, noise.bias_yaw_rate_walk,
            noise.wheel_scale_walk, noise.slope_share_walk, noise.slope_share_walk,
            noise.imu_turn_walk, noise.imu_ahead_walk, 0.0, 0.0, noise.heading_turn_walk,
        ]) * np.sqrt(DT)  # fmt: skip
        start = initial_std()[5:]
        drift = rng.normal(0, start) + np.cumsum(rng.normal(0, walk, (n + 1, 11)), axis=0)
        drift[:, 4:6] += 1.0
        if ahead is not None:
            drift[:, 7] = ahead
        at = np.append(np.repeat(drift[:-1, 7], FINE), drift[-1, 7])
        ax, ay = ax - at * rate**2, ay + at * np.gradient(rate, t)
        # an inertial unit reports increments: the mean over the sample
        self.imu = np.column_stack([(0.5 * (s[1:] + s[:-1])).reshape(n, FINE).mean(axis=1) for s in (ax, ay, rate)])
        self.imu[:, :2] -= self.gravity[1:] * drift[:-1, 4:6]
        self.imu[:, :2] = self._turned(self.imu[:, :2], drift[:-1, 6])
        self.imu += drift[:-1, :3] + rng.normal(0, [accel_std, accel_std, CAR.yaw_rate], (n, 3))
        self.truth = np.column_stack([a[::FINE] for a in (x, y, yaw, self.vx, self.vy)] + [drift])
        # the receiver's place of the car wanders away from it
        wander = rng.normal(0, CAR.position_wander * np.sqrt(DT), (n + 1, 2)) + drift[:, 8:10] * DT
        self.truth[:, :2] += np.cumsum(wander, axis=0)
        late = noise.position_delay * self.truth[:, VX] * rng.normal(0, 1, n + 1)
        way = np.column_stack([np.cos(self.truth[:, YAW]), np.sin(self.truth[:, YAW])])
        self.headings = self.truth[:, YAW] + self.truth[:, HEADING_TURN] + rng.normal(0, HEADING_STD, n + 1)
        self.fixes = self.truth[:, :2] + rng.normal(0, CAR.position, (n + 1, 2)) + late[:, None] * way
        self.wheels = self.truth[:, [VX, VX]] * (1 + self.truth[:, [8, 8]])
        slip = np.hypot(CAR.wheel_speed, noise.wheel_rolling * self.truth[:, [VX, VX]])
        self.wheels = self.wheels + rng.normal(0, slip)

    @staticmethod
    def _turned(force: np.ndarray, left: np.ndarray) -> np.ndarray:
        """As a unit feels it that is turned to the left."""
        c, s = np.cos(left), np.sin(left)
        return np.column_stack([c * force[:, 0] + s * force[:, 1], c * force[:, 1] - s * force[:, 0]])

    @staticmethod
    def _waves(rng: np.random.Generator, t: np.ndarray, size: float, top_hz: float) -> np.ndarray:
        f, phase = rng.uniform(0.05, top_hz, 4), rng.uniform(0, 2 * np.pi, 4)
        return size * np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1) / 2

    @staticmethod
    def _integral(rate: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])


def initial_std() -> np.ndarray:
    n, d = NOISE, StateFilter(load_car()).declared
    return np.array([
        n.initial_position, n.initial_position, n.initial_yaw, n.initial_speed, n.initial_speed,
        d["bias_ax"], d["bias_ay"], d["bias_yaw_rate"], d["wheel_scale"],
        n.initial_slope_share, n.initial_slope_share, d["imu_turn"], d["imu_ahead"],
        n.position_drift, n.position_drift, n.initial_heading_turn,
    ])  # fmt: skip


def started(drive: Drive, rng: np.random.Generator) -> StateFilter:
    f = StateFilter(load_car())
    f.covariance = np.diag(initial_std() ** 2)
    f.mean = drive.truth[0] + rng.normal(0, initial_std())
    f.mean[5:] = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    f.yaw_rate = drive.imu[0, 2]
    return f


def step(f: StateFilter, drive: Drive, k: int, *, headed: bool = False) -> tuple[float, int]:
    """One sample of all sensors, a receiver's heading too where `headed`; returns the sum of their NIS and its degrees
    of freedom."""
    f.predict(ImuReading(*drive.imu[k - 1], *drive.gravity[k]), DT)
    nis = f.update_wheel_speeds(*drive.wheels[k], steer=0.0, drive=0.0)
    if headed and (found := f.update_heading(drive.headings[k] + 2 * np.pi, HEADING_STD)) is not None:
        nis.append(found)
    if k % 5 == 0 and (fix := f.update_position(*drive.fixes[k])) is not None:
        return sum(nis) + fix, len(nis) + 2
    return sum(nis), len(nis)


@pytest.mark.promise("N3")
@pytest.mark.parametrize("headed", [False, True], ids=["positions alone", "with headings"])
def test_state_filter_is_consistent_over_many_runs_with_known_truth(headed: bool) -> None:
    roots, runs, seconds = (101, 103), volume(100, 400), 6.0
    checks = range(200, round(seconds / DT) + 1, 50)
    nees = np.zeros((runs, len(checks)))
    nis, freedom = 0.0, 0
    for seed in range(runs):
        rng = np.random.default_rng([roots[seed % 2], seed // 2])
        drive = Drive(rng, seconds)
        f = started(drive, rng)
        for k in range(1, len(drive.truth)):
            added, degrees = step(f, drive, k, headed=headed)
            nis, freedom = nis + added, freedom + degrees
            if k in checks:
                error = f.mean - drive.truth[k]
                error[YAW] = (error[YAW] + np.pi) % (2 * np.pi) - np.pi
                nees[seed, checks.index(k)] = error @ np.linalg.solve(f.covariance, error)
    low, high = stats.chi2.ppf([0.025, 0.975], len(STATES) * runs) / runs
    inside = float(((nees.mean(axis=0) > low) & (nees.mean(axis=0) < high)).mean())
    assert nees.mean() == pytest.approx(len(STATES), rel=0.1), "far outside of the band: not this drive's noise"
    nis_low, nis_high = stats.chi2.ppf([0.025, 0.975], freedom) / freedom
    mean = nis / freedom
    assert mean == pytest.approx(1.0, abs=0.02), "far outside of the band: not this drive's noise"
    of_nees = f"NEES {nees[:, -1].mean():.2f} in {low:.2f} to {high:.2f} at the end, at {inside:.0%} of the moments"
    figure = f"{of_nees}; NIS {mean:.4f} in {nis_low:.4f} to {nis_high:.4f}"
    within = inside >= 0.85 and low < nees[:, -1].mean() < high and nis_low < mean < nis_high
    of = "with headings of a receiver, " if headed else ""
    record_figure("N3", f"state filter, {of}{runs} unseen runs: {figure}", missed=not within)


@pytest.mark.parametrize("turn", [-0.03, 0.03])
def test_a_turned_imu_is_found_and_its_forces_are_turned_back(turn: float) -> None:
    rng = np.random.default_rng(7)
    drive = Drive(rng, 30.0)
    straight = Drive._turned(drive.imu[:, :2], -drive.truth[:-1, IMU_TURN])
    drive.imu[:, :2] = Drive._turned(straight, np.full(len(straight), turn))
    f = started(drive, rng)
    for k in range(1, len(drive.truth)):
        step(f, drive, k)
    assert f.std()[IMU_TURN] < 0.5 * f.declared["imu_turn"]
    assert abs(f.mean[IMU_TURN] - turn) < 3.0 * f.std()[IMU_TURN]
    f.mean[IMU_AHEAD] = 0.0
    felt = np.array([2.0, -25.0])
    back = Drive._turned((felt - f.mean[[BIAS_AX, BIAS_AY]])[None], np.array([-f.mean[IMU_TURN]]))[0]
    assert f.specific_force(*felt) == pytest.approx(tuple(back))


@pytest.mark.parametrize("ahead", [-0.8, 0.5])
def test_an_imu_that_is_not_where_it_is_declared_is_found(ahead: float) -> None:
    """What it feels of the car's turning in passes neither for side slip nor for lateral force."""
    rng = np.random.default_rng(8)
    drive = Drive(rng, 30.0, ahead=ahead)
    f, wrong = started(drive, rng), []
    f.mean[IMU_AHEAD] = 0.0
    for k in range(1, len(drive.truth)):
        step(f, drive, k)
        wrong.append(f.mean[VY] - drive.truth[k, VY])
    assert abs(f.mean[IMU_AHEAD] - ahead) < min(3.0 * f.std()[IMU_AHEAD], 0.1)
    assert np.std(wrong[len(wrong) // 2 :]) < 1.5 * f.std()[VY]


def test_forces_of_an_imu_ahead_of_the_centre_are_those_at_the_centre() -> None:
    """Yaw rate 0.3 rad/s and rising by 1 rad/s2, the car's own force 0."""
    f, ahead = StateFilter(load_car()), 0.5
    f.initialise(0.0, 0.0, 0.0, 30.0)
    f.mean[IMU_AHEAD] = ahead
    for k in range(31):
        f.predict(ImuReading(0.0, 0.0, 0.01 * k), DT)
    assert f.specific_force(-ahead * 0.3**2, ahead * 1.0) == pytest.approx((0.0, 0.0), abs=0.01)


def test_covariance_stays_symmetric_and_psd_over_a_long_drive() -> None:
    rng = np.random.default_rng(3)
    drive = Drive(rng, 60.0)
    f = started(drive, rng)
    for k in range(1, len(drive.truth)):
        step(f, drive, k)
        f.update_rear_slip(float(drive.imu[k - 1, 1]))
    assert np.array_equal(f.covariance, f.covariance.T)
    assert np.linalg.eigvalsh(f.covariance)[0] > 0


def test_wrong_initial_heading_is_corrected_by_motion() -> None:
    rng = np.random.default_rng(4)
    drive = Drive(rng, 4.0)
    f = started(drive, rng)
    f.mean[YAW] = drive.truth[0, YAW] + 0.5
    for k in range(1, len(drive.truth)):
        step(f, drive, k)
    assert abs(f.mean[YAW] - drive.truth[-1, YAW]) < min(3.0 * f.std()[YAW], 0.1)


def test_jumping_fixes_and_spinning_wheels_are_gated_out() -> None:
    rng = np.random.default_rng(5)
    drive = Drive(rng, 8.0)
    f = started(drive, rng)
    for k in range(1, len(drive.truth)):
        if 400 <= k < 500:
            drive.fixes[k] += 40.0
            drive.wheels[k, 1] *= 1.5
        step(f, drive, k)
    assert f.rejected >= 20 + 90
    assert np.hypot(*(f.mean - drive.truth[-1])[:2]) < 0.3
    assert abs(f.mean[VX] - drive.truth[-1, VX]) < 0.3
    assert abs(f.mean[VY] - drive.truth[-1, VY]) < 0.5


def test_standing_still_reveals_the_biases_and_wandering_fixes_do_not_turn_the_car() -> None:
    rng = np.random.default_rng(6)
    f = StateFilter(load_car())
    f.initialise(0.0, 0.0, 0.3)
    bias, wander = np.array([0.12, -0.08, 0.004]), np.zeros(2)
    for k in range(3000):
        imu = ImuReading(*(bias + rng.normal(0, [0.1, 0.1, 0.003])))
        f.predict(imu, DT, moves=False)
        f.update_standstill(imu)
        f.update_wheel_speeds(0.0, 0.0, 0.0, 0.0)
        if k % 5 == 0:
            wander += rng.normal(0, 0.02, 2)
            f.update_position(*wander)
    assert np.hypot(*wander) > 0.3
    assert np.allclose(f.mean[5:7], bias[:2], atol=0.03)
    assert f.mean[7] == pytest.approx(bias[2], abs=5e-4)
    assert abs(f.mean[YAW] - 0.3) < 0.01


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_wheels_without_a_direction_leave_the_one_that_the_forces_show(way: float) -> None:
    """0.5 m/s2 for 2 s out of rest, either way."""
    rng = np.random.default_rng(9)
    f, speed = StateFilter(load_car()), 0.0
    f.initialise(0.0, 0.0, 0.3, vx_std=0.02)
    for _ in range(200):
        speed += 0.5 * way * DT
        f.predict(ImuReading(0.5 * way + rng.normal(0, 0.1), 0.0, 0.0), DT)
        f.update_wheel_speeds(*(abs(speed + rng.normal(0, 0.02, 2))), steer=0.0, drive=0.0)
    assert f.mean[VX] == pytest.approx(way, abs=0.05)


def test_a_speed_of_unknown_direction_is_either_and_says_so() -> None:
    f = StateFilter(load_car())
    f.initialise(0.0, 0.0, 0.3, vx_std=1.0)
    for _ in range(50):
        f.predict(ImuReading(0.0, 0.0, 0.0), DT)
        f.update_wheel_speeds(1.0, 1.0, steer=0.0, drive=0.0)
    assert abs(f.mean[VX]) < 0.1
    assert f.std()[VX] == pytest.approx(1.0, abs=0.2)
