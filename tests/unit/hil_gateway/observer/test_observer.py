"""The observer learns what is slow about a car, and finds an IMU or wheels that no longer fit.

The car here has linear tyres.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import pytest
from support.cars.scripted_car import reported_state
from support.cars.turning_car import PUSHED, TurningCar

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.observer.kalman_step import Known
from hil_gateway.observer.lateral import SHARE, fitted, gripped, left_of_both
from hil_gateway.observer.observer import Acts, Observer

CONFIG = Config()
CAR = CONFIG.vehicle
SPEED = 50.0
Change = Callable[[dict[str, float]], dict[str, float]]


@pytest.fixture
def state() -> VehicleState:
    return reported_state()


class Drive:
    """A car that weaves, with noise on all that it reports; `zero` is the true steering angle less the reported one,
    which is `late_s` ahead of it; `weaves` are amplitude (rad) and frequency (rad/s) of the steering."""

    def __init__(
        self, state: VehicleState, zero: float = 0.0, late_s: float = 0.0, weaves: tuple[float, float] = (0.012, 1.2)
    ) -> None:
        self._state, self._zero, self._late_s, self._weaves = state, zero, late_s, weaves
        self.observer, self.car, self._t = Observer(CONFIG), TurningCar(CAR, SPEED), 0.0

    def run(
        self,
        seconds: float,
        change: Change = dict,
        *,
        steers: bool = True,
        braking: float = 0.0,
        pushed: float = PUSHED,
    ) -> tuple[float, float]:
        """Largest shares of chance that the IMU and one axle' wheels came to; with `braking` (m/s2) the car becomes
        slower in the wheels' speeds and for the IMU alone."""
        imu = wheels = 0.0
        pushed = 0.0 if braking else pushed
        for tick in range(round(100 * seconds)):
            reported = self.reports()
            slower = {name: value - 0.01 * tick * braking for name, value in reported.items() if "wheel" in name}
            state = self._state.model_copy(
                update=change(reported | slower | {"ax": reported["ax"] - PUSHED + pushed - braking})
            )
            acts, imu_reports = Acts(state.steer, 0.54 * braking, 0.46 * braking, pushed), state.sources["imu"].valid
            speed = SPEED - 0.01 * tick * braking
            self.observer.step(state, speed, speed, acts, 0.0, imu_reports, judges=True, steers=steers)
            imu, wheels = max(imu, self.observer.imu_off), max(wheels, self.observer.wheel_off)
        return imu, wheels

    @property
    def true_yaw_rate(self) -> float:
        return self.car.yaw_rate

    def reports(self) -> dict[str, float]:
        far, fast = self._weaves
        steer, late = (far * math.sin(fast * t) for t in (self._t, self._t - self._late_s))
        self.car.turn(late + self._zero)
        self._t += 0.01
        return {"steer": steer, **self.car.reports()}


def times(signs: tuple[float, float, float]) -> Change:
    names = ("yaw_rate", "ay", "ax")
    return lambda now: now | {name: sign * now[name] for name, sign in zip(names, signs, strict=True)}


@pytest.mark.parametrize("zero", [0.006, -0.006])
def test_a_steering_zero_is_learnt_and_no_fault(state: VehicleState, zero: float) -> None:
    drive = Drive(state, zero)
    imu, wheels = drive.run(12.0)
    assert drive.observer.steer_zero == pytest.approx(zero, abs=0.001)
    assert max(imu, wheels) < 1.0


def test_a_steering_later_than_it_reports_is_learnt_and_makes_no_imu_wrong(state: VehicleState) -> None:
    assert Drive(state, late_s=0.1, weaves=(0.02, 5.0)).run(5.0)[0] < 0.3


@pytest.mark.parametrize(("mean", "deviation"), [(0.0, 0.1), (0.3, 0.8), (-1.0, 0.5), (2.0, 1.0)])
def test_a_tyre_is_as_stiff_as_it_is_on_average_where_its_slip_may_be(mean: float, deviation: float) -> None:
    draw, x = random.Random(5), ca.SX.sym("x")
    slips = [draw.gauss(mean, deviation) for _ in range(20_000)]
    line = fitted(ca.tanh, x, x, Known(ca.SX(mean), ca.SX(deviation**2)))
    height, slope, rest = (
        float(ca.evalf(ca.substitute(e, x, mean))) for e in (line.at, ca.jacobian(line.at, x), line.rest)
    )
    assert height == pytest.approx(sum(map(math.tanh, slips)) / len(slips), abs=0.03)
    assert slope == pytest.approx(sum(1.0 - math.tanh(slip) ** 2 for slip in slips) / len(slips), abs=0.05)
    off = [math.tanh(slip) - height - slope * (slip - mean) for slip in slips]
    assert rest == pytest.approx(math.sqrt(sum(e**2 for e in off) / len(off)), abs=0.07)


@pytest.mark.parametrize(("wheels_tell", "blamed"), [(True, False), (False, True)])
def test_a_car_that_slides_as_its_wheels_and_its_gyro_say_has_a_sound_imu(
    state: VehicleState, wheels_tell: bool, blamed: bool
) -> None:
    """Rear tyres that hold a third less than they did; where no wheels report, no one tells a slide from a fault."""
    sources = state.sources | {"wheel_speeds": replace(state.sources["wheel_speeds"], valid=wheels_tell)}
    drive = Drive(state.model_copy(update={"sources": sources}))
    drive.run(12.0)
    drive.car.stiffer = 1.0, 0.7
    assert (drive.run(1.2)[0] > 1.0) is blamed


@pytest.mark.parametrize("beyond", [-0.1, 0.0, 0.1])
def test_the_balance_of_the_brakes_is_learnt_from_how_the_car_turns(state: VehicleState, beyond: float) -> None:
    """Tyres that brake hold less across, tyres that carry more hold more."""
    drive, imu = Drive(state, weaves=(0.012, 3.0)), 0.0
    for _ in range(6):
        drive.car.stiffer = 1.0, 1.0
        drive.run(3.0)
        drive.car.stiffer = stiffer(0.54 + beyond, 10.0)
        imu = max(imu, drive.run(1.0, braking=10.0)[0])
    assert drive.observer._lateral.main.now[SHARE] == pytest.approx(beyond, abs=0.07)
    assert imu < 0.5


@pytest.mark.parametrize(("lean", "kept"), [(0.0, 0.954), (0.5, 0.935), (0.7, 0.882)])
def test_an_axle_that_leans_keeps_less_across_under_brakes(lean: float, kept: float) -> None:
    """Its inner wheel carries less and brakes as much: 0.3 of what the axle grips with."""
    assert float(ca.evalf(left_of_both(ca.SX(lean), ca.SX(0.3)))) == pytest.approx(kept, abs=0.005)


@pytest.mark.parametrize(("load", "grips"), [(9.80665, 9.80665), (19.6133, 17.652), (98.0665, 29.42)])
def test_a_tyre_loses_friction_with_load_but_never_all(load: float, grips: float) -> None:
    assert gripped(load, 0.1) == pytest.approx(grips, abs=0.01)


def stiffer(share: float, braking: float) -> tuple[float, float]:
    """Tyres of front and rear axle, where the front one brakes with this `share` of `braking` (m/s2)."""

    def axle(at_rest: float, arm: float, braked: float) -> float:
        load, along = at_rest + braking * CAR.cg_height / arm, braked * braking * CAR.wheelbase / abs(arm)
        return load / at_rest * math.sqrt(1.0 - (along / (1.6 * load)) ** 2)

    front, rear = CAR.axles_pressed(SPEED)
    return axle(front, CAR.lr, share), axle(rear, -CAR.lf, 1.0 - share)


@pytest.mark.parametrize("signs", [(-1.0, -1.0, -1.0), (1.0, -1.0, -1.0)])
def test_an_imu_of_another_sign_is_found(state: VehicleState, signs: tuple[float, float, float]) -> None:
    drive = Drive(state, 0.006)
    drive.run(10.0)
    imu, wheels = drive.run(1.0, times(signs))
    assert imu > 1.0 > wheels


@pytest.mark.parametrize("wheel", ["wheel_speed_fl", "wheel_speed_rr"])
def test_one_wheel_that_is_wrong_is_found_at_once(state: VehicleState, wheel: str) -> None:
    drive = Drive(state)
    drive.run(10.0)
    assert drive.observer.wheel_off < 1.0
    drive.run(0.05, lambda now: now | {wheel: 0.7 * now[wheel]})
    assert drive.observer.wheel_off > 1.0


def test_under_full_throttle_front_wheels_are_judged_as_when_they_roll(state: VehicleState) -> None:
    drive = Drive(state)
    drive.run(10.0)
    drive.run(2.0, pushed=12.0)
    assert drive.observer.wheel_off < 1.0
    drive.run(0.05, lambda now: now | {"wheel_speed_fl": 0.95 * now["wheel_speed_fl"]}, pushed=12.0)
    assert drive.observer.wheel_off > 1.0


@pytest.mark.parametrize(("share", "found"), [(0.8, True), (0.99, False)])
def test_wheels_that_are_all_a_fifth_wrong_do_not_fit_imu_and_engine(
    state: VehicleState, share: float, found: bool
) -> None:
    drive = Drive(state)
    drive.run(10.0)
    observer, now = drive.observer, state.model_copy(update=drive.reports())
    observer.step(now, SPEED, share * SPEED, Acts(now.steer, 0.0, 0.0, PUSHED), 0.0, imu=True, judges=True, steers=True)
    assert (observer.speed_off > 1.0) is found


@pytest.mark.parametrize("steers", [True, False])
def test_without_the_imu_it_knows_how_the_car_turns(state: VehicleState, steers: bool) -> None:
    """Also where the steering does not do what it reports: by the wheels."""
    drive = Drive(state)
    drive.run(10.0)
    drive.run(2.0, lambda now: now | {"yaw_rate": 1.0, "steer": now["steer"] if steers else 0.0}, steers=steers)
    assert drive.observer.yaw_rates[1] == pytest.approx(drive.true_yaw_rate, abs=0.03)


@pytest.mark.parametrize("offset", [0.3, -0.3])
def test_a_gyro_that_is_off_is_found_at_once(state: VehicleState, offset: float) -> None:
    drive = Drive(state)
    drive.run(10.0)
    assert drive.run(0.05, lambda now: now | {"yaw_rate": now["yaw_rate"] + offset})[0] > 1.0


def test_a_wheel_that_locks_under_the_brakes_does_not_make_the_imu_wrong(state: VehicleState) -> None:
    drive, turns = Drive(state), iter(range(1000))
    drive.run(20.0)
    imu, _ = drive.run(
        0.4, lambda r: r | {"wheel_speed_fr": (1.0 - 0.02 * next(turns)) * r["wheel_speed_fr"]}, braking=16.0
    )
    assert imu < 0.5


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_wheels_of_one_side_that_are_a_fifth_wrong_are_found_and_not_the_imu(state: VehicleState, share: float) -> None:
    drive = Drive(state)
    drive.run(10.0)
    imu, wheels = drive.run(
        1.0, lambda now: now | {name: share * now[name] for name in ("wheel_speed_fl", "wheel_speed_rl")}
    )
    assert wheels > 1.0 > imu


def test_with_nothing_reported_it_goes_on_as_the_tyres_have_been_learnt(state: VehicleState) -> None:
    drive = Drive(state)
    drive.run(10.0)
    silent = {name: replace(source, valid=False) for name, source in state.sources.items()}
    drive.run(1.0, lambda now: now | {"sources": silent})
    assert drive.observer.yaw_rates[1] == pytest.approx(drive.true_yaw_rate, abs=0.03)


def test_nothing_is_judged_where_the_steering_is_not_known(state: VehicleState) -> None:
    drive = Drive(state)
    drive.run(10.0)
    assert drive.run(0.1, lambda now: now | {"yaw_rate": 1.0}, steers=False) == (0.0, 0.0)
