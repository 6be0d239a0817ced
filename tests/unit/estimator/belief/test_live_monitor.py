"""The live monitor: silent while the model explains the car, and where it fails it says so and suspects why."""

from __future__ import annotations

from typing import Any

import numpy as np
from support.measurement_evaluation import MeasurementEvaluation

from estimator.belief.residual_monitor import ResidualMonitor
from estimator.belief.tyre_belief import Sample
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.car.car import load_car

DT_NS = 10_000_000
START_NS = 1_000_000_000
VEHICLE = load_car().vehicle


class Laps:
    """Samples of a car on laps with left and right turns at several speeds; the model's own physics plus a defect."""

    def __init__(self, seed: int = 3) -> None:
        self.model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"))
        self.theta = np.array([p.prior for p in self.model.tyre_table])
        self.known = np.zeros((self.theta.size, self.theta.size))
        self.state = np.zeros((3, 3))
        self._h = MeasurementEvaluation(self.model, "imu_yaw")
        self._rng = np.random.default_rng(seed)

    def sample(self, k: int) -> Sample:
        t = k * 0.01
        vx = 35.0 + 15.0 * np.sin(0.11 * t)
        slip = 0.045 * np.sin(0.5 * t)
        w = 0.25 * np.sin(0.31 * t)
        vy = VEHICLE.lr * w - vx * np.tan(slip)
        steer = slip + np.arctan((vy + VEHICLE.lf * w) / vx)
        signals = np.array([vx, vy, w, steer, 0.06 * np.sin(0.23 * t)])
        z = self._h(signals, np.zeros(len(AUXILIARY)), self.theta)[0] + self._rng.normal(0, [0.11, 0.11, 0.05])
        return Sample(signals, self.state, z, np.zeros(len(AUXILIARY)))

    def findings(self, defect: Any, seconds: float = 100.0) -> list[Any]:
        monitor, found = ResidualMonitor(self.model), []
        for k in range(round(seconds * 100)):
            sample = self.sample(k)
            lacking = sample._replace(z=sample.z + defect(sample))
            found += monitor.push(lacking, self.theta, self.known, START_NS + k * DT_NS)
        return found


def test_monitor_is_silent_while_the_model_explains_the_car() -> None:
    assert Laps().findings(lambda s: np.zeros(3)) == []


def test_monitor_says_where_the_model_fails() -> None:
    """Only right turns above 40 m/s lose grip: that, and nothing else, is reported."""

    def defect(s: Sample) -> np.ndarray:
        fails = s.signals[0] > 40.0 and s.z[1] < -5.0
        return np.array([0.0, 1.2 if fails else 0.0, 0.0])

    found = Laps().findings(defect)
    assert {(f.channel, f.condition) for f in found} == {("ay", "right turns above 40 m/s")}
    assert found[0].strength > 5.0


def test_monitor_blames_nothing_on_the_model_that_belief_or_state_do_not_know_yet() -> None:
    """A lateral residual of 1.2 m/s2: tyres known to 15 % explain it, and so does a side slip known to 0.3 m/s."""
    sure, unlearnt, slipping = Laps(), Laps(), Laps()
    unlearnt.known = np.diag([(0.15 * p.prior) ** 2 for p in unlearnt.model.tyre_table])
    slipping.state = np.diag([0.0, 0.3**2, 0.0])
    for laps, seconds, alerts in ((sure, 20.0, True), (slipping, 20.0, False), (unlearnt, 100.0, False)):
        assert bool(laps.findings(lambda s: np.array([0.0, 1.2 if s.z[1] > 5.0 else 0.0, 0.0]), seconds)) == alerts


def test_monitor_suspects_the_effect_that_is_there() -> None:
    drag = Laps().findings(lambda s: np.array([-0.6 * s.signals[0] ** 2 / VEHICLE.mass, 0.0, 0.0]))
    assert {f.channel for f in drag} == {"ax"}
    assert drag[-1].suspected_effect == "aero_drag"
    assert len(drag) <= 3, "one defect is a few alerts, not one for every place it shows"
    damping = Laps().findings(lambda s: np.array([0.0, 0.0, -1500.0 * s.signals[2] / VEHICLE.yaw_inertia]))
    assert {f.suspected_effect for f in damping if f.channel == "yaw_acc"} == {"yaw_damping"}


def test_the_residual_told_is_what_the_model_lacks_since_it_was_last_asked_for() -> None:
    laps, lacking = Laps(), np.array([-1.5, 0.8, 0.3])
    monitor = ResidualMonitor(laps.model)
    assert monitor.residual() is None
    for k in range(100):
        sample = laps.sample(k)
        monitor.push(sample._replace(z=sample.z + lacking), laps.theta, laps.known, START_NS + k * DT_NS)
    told = monitor.residual()
    assert told is not None and np.abs(told - lacking).max() < 0.1, "25 looks at noise of 0.11"
    assert monitor.residual() is None


def test_an_alert_is_not_repeated_within_a_minute() -> None:
    found = Laps().findings(lambda s: np.array([-1.5, 0.0, 0.0]), seconds=55.0)
    assert len({(f.channel, f.condition) for f in found}) == len(found) > 0


def test_monitor_survives_meaningless_numbers() -> None:
    laps = Laps()
    monitor = ResidualMonitor(laps.model)
    for k, bad in enumerate((np.nan, np.inf, 1e300) * 20):
        sample = laps.sample(k)
        assert monitor.push(sample._replace(z=np.array([bad, 0.0, 0.0])), laps.theta, laps.known, START_NS) == []
    assert monitor.residual() is None
