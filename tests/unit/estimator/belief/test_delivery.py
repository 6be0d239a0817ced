"""What tyres and brakes deliver is known within a tenth of a second, axle by axle, and only where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.measurement_evaluation import MeasurementEvaluation

from estimator.belief.delivery import CONFIRMED, LATE, WINDOW, Delivery
from estimator.belief.tyre_belief import Sample
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.bus.delivered import Delivered
from hil_gateway.car.car import load_car

MODEL = SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"))
NAMES = [p.name for p in MODEL.tyre_table]
BELIEVED = np.array([p.prior for p in MODEL.tyre_table])
NO_AUX = np.zeros(len(AUXILIARY))
EVALUATION = MeasurementEvaluation(MODEL, "imu_yaw")


def sample(slip: float, drive: float = 0.0, **shares: float) -> Sample:
    """Both axles at `slip` in a bend at 40 m/s, of a car with these `shares` of its believed parameters."""
    v, vx, yaw_rate = MODEL.vehicle, 40.0, 0.35
    vy = v.lr * yaw_rate - vx * np.tan(slip)
    signals = np.array([vx, vy, yaw_rate, slip + np.arctan((vy + v.lf * yaw_rate) / vx), drive])
    true = BELIEVED * np.array([shares.get(name, 1.0) for name in NAMES])
    return Sample(signals, np.zeros((3, 3)), EVALUATION(signals, NO_AUX, true)[0], NO_AUX)


ROLL = (0.0, 0.0)


def seen(taken: Sample, samples: int = WINDOW, slips: tuple[float, float] = ROLL) -> Delivered | None:
    delivery = Delivery(MODEL)
    for _ in range(samples):
        delivery.push(taken, BELIEVED, slips)
    return delivery.now()


def test_a_wet_road_is_known_after_a_tenth_of_a_second() -> None:
    wet = sample(0.06, df=0.8, dr=0.8)
    assert seen(wet, WINDOW - 1) is None
    found = seen(wet)
    assert found is not None
    assert (found.front, found.rear) == (pytest.approx(0.8, abs=0.01), pytest.approx(0.8, abs=0.01))


@pytest.mark.parametrize(("weak", "front", "rear"), [("df", 0.6, 1.0), ("dr", 1.0, 0.6)])
def test_a_weak_axle_is_told_from_the_other(weak: str, front: float, rear: float) -> None:
    found = seen(sample(0.06, **{weak: 0.6}))
    assert found is not None
    assert (found.front, found.rear) == (pytest.approx(front, abs=0.02), pytest.approx(rear, abs=0.02))


def test_weak_brakes_are_no_weak_tyres() -> None:
    found = seen(sample(0.0, drive=-0.2, cx=0.7), LATE + WINDOW)
    assert found is not None
    assert (found.front, found.rear, found.brakes) == (None, None, pytest.approx(0.7, abs=0.01))


def test_brakes_that_act_a_tenth_of_a_second_late_are_no_weak_brakes() -> None:
    delivery, shares = Delivery(MODEL), []
    pressed = [min(0.01 * i, 0.25) for i in range(60)]
    for reported, acting in zip(pressed[10:], pressed, strict=False):
        asked, done = sample(0.0, drive=-reported), sample(0.0, drive=-acting)
        delivery.push(Sample(asked.signals, asked.signal_covariance, done.z, NO_AUX), BELIEVED, ROLL)
        shares.append(now.brakes if (now := delivery.now()) else None)
    told = [share for share in shares if share is not None]
    assert told
    assert min(told) > 0.95


@pytest.mark.parametrize(("late_s", "low", "high"), [(0.0, 0.0, 0.9), (0.06, 0.99, 1.01)])
def test_tyres_are_asked_at_the_angle_that_the_road_wheels_have(late_s: float, low: float, high: float) -> None:
    """A bend that is entered with road wheels 60 ms behind what is reported."""
    delivery, shares, bend = Delivery(MODEL), [], sample(0.06)
    angles = [float(bend.signals[3]) - 0.002 * max(20 - i, 0) for i in range(40)]
    for i, reported in enumerate(angles):
        signals = bend.signals.copy()
        signals[3] = angles[max(i - 6, 0)]
        measured = EVALUATION(signals, NO_AUX, BELIEVED)[0]
        signals[3] = reported
        delivery.push(Sample(signals, np.zeros((3, 3)), measured, NO_AUX), BELIEVED, ROLL, late_s)
        shares.append(now.front if (now := delivery.now()) else None)
    told = [share for share in shares if share is not None]
    assert told
    assert low < min(told) < high


def test_locked_wheels_tell_of_the_road_and_not_of_the_brakes() -> None:
    found = seen(sample(0.0, drive=-0.2, cx=0.7), slips=(0.3, 0.0))
    assert found is not None
    assert found.brakes is None
    assert found.front == found.rear


def test_the_axle_whose_wheels_lock_is_named_until_they_roll() -> None:
    delivery, braking = Delivery(MODEL), sample(0.0, drive=-0.2)
    named = []
    for slips in [ROLL] * WINDOW + [(0.3, 0.05)] * CONFIRMED + [(0.05, 0.05)]:
        delivery.push(braking, BELIEVED, slips)
        named.append(now.locking if (now := delivery.now()) else None)
    assert named[-CONFIRMED:] == [(False, False)] * (CONFIRMED - 2) + [(True, False), (False, False)]


def test_a_car_that_hardly_uses_its_tyres_tells_nothing() -> None:
    assert seen(sample(0.01, df=0.5, dr=0.5, drive=-0.05)) is None


def test_what_is_no_number_tells_nothing() -> None:
    broken: Any = sample(0.06)
    broken.z[1] = np.nan
    assert seen(broken) is None
