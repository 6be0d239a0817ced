"""Limits signal by signal, to the raw step."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.gateway.act.limits import Limits, RawCommand, SignalLimit, _signal_limit
from hil_gateway.process.errors import InputError
from hil_gateway.settings.gateway import LimitConfig

CAR = load_car()
LIMITS = Limits(CAR, LimitConfig().within(CAR))
REST = ActuatorPositions(0.0, 0.0, 0.0, 0.0, 1)
STILL = RawCommand(0, 0, 0, 0, 1)
STEERING = math.radians(0.5)


def test_bounds_and_rates_are_the_declared_ones_in_raw_steps():
    bounds = {name: (limit.low, limit.high, limit.up, limit.down) for name, limit in LIMITS.signals.items()}
    assert bounds == {
        "steering_motor": (-479, 479, 10, 10),  # 239.8 deg lies between two steps of 0.5
        "accelerator": (0, 10_000, 400, 10_000),
        "brake_front": (0, 6000, 1800, 600),
        "brake_rear": (0, 6000, 1800, 600),
        "gear": (0, 6, 1, 1),
    }
    assert LIMITS.signals["steering_motor"].scale == pytest.approx(STEERING)
    assert LIMITS.signals["accelerator"].scale == pytest.approx(1e-4)
    assert LIMITS.signals["brake_front"].scale == pytest.approx(1e3)


@pytest.mark.parametrize(
    ("wanted", "previous", "raw"),
    [
        (0.0, 0, 0), (3.4, 0, 3), (3.6, 0, 4), (-3.6, 0, -4), (5.0, 0, 5), (5.01, 0, 5), (99.0, 0, 5), (-99.0, 0, -7),
        (99.0, 18, 20), (99.0, 20, 20), (-99.0, -18, -20), (-20.0, -18, -20), (20.0, 18, 20),
        (math.inf, 0, 5), (-math.inf, 0, -7), (math.nan, 3, 3), (math.nan, 30, 23), (math.nan, -30, -25),
        (0.0, 40, 33), (0.0, -40, -35),
    ],
)  # fmt: skip
def test_a_signal_goes_as_far_as_it_may(wanted, previous, raw):
    """Bounds -20..20, up 5 and down 7 a frame; a previous value outside is led back no faster than that."""
    limit = SignalLimit("x", 1.0, 0.0, -20, 20, 5, 7)
    if abs(previous) <= 20:
        assert limit.apply(wanted, previous) == raw
    else:
        assert limit.apply(wanted, previous) in (raw, 20 if previous > 0 else -20)


def test_the_scale_is_applied_once():
    assert SignalLimit("x", 0.25, 0.0, -100, 100, 100, 100).apply(5.0, 0) == 20


def test_what_is_admissible_is_not_called_limited():
    command, changed = LIMITS.apply(ActuatorPositions(4.2 * STEERING, 0.03, 0.0, 0.0, 2), STILL)
    assert command == RawCommand(4, 300, 0, 0, 2)
    assert changed == ()


@pytest.mark.parametrize(
    ("wanted", "name", "expected"),
    [
        (REST._replace(steering_motor=11 * STEERING), "steering_motor", {"steering_motor": 10}),
        (REST._replace(steering_motor=-11 * STEERING), "steering_motor", {"steering_motor": -10}),
        (REST._replace(accelerator=0.0402), "accelerator", {"accelerator": 400}),
        (REST._replace(accelerator=-0.5), "accelerator", {}),
        (REST._replace(brake_front=1.802e6), "brake_front", {"brake_front": 1800}),
        (REST._replace(brake_rear=1.802e6), "brake_rear", {"brake_rear": 1800}),
        (REST._replace(gear=3), "gear", {"gear": 2}),
        (REST._replace(steering_motor=math.nan), "steering_motor", {}),
        (REST._replace(accelerator=math.nan), "accelerator", {}),
    ],
)
def test_each_limit_is_named_when_it_acts(wanted, name, expected):
    command, changed = LIMITS.apply(wanted, STILL)
    assert command == STILL._replace(**expected)
    assert changed == (name,)


def test_a_command_takes_some_signals_from_another():
    own, other = RawCommand(10, 20, 30, 40, 5), RawCommand(11, 21, 31, 41, 6)
    assert own.with_those_of(other, ("brake_front", "gear")) == RawCommand(10, 20, 31, 40, 6)


def test_half_a_step_is_rounding_and_a_whole_one_is_a_limit():
    _, rounded = LIMITS.apply(REST._replace(brake_front=1_800_499.0), STILL)
    _, limited = LIMITS.apply(REST._replace(brake_front=1_801_000.0), STILL)
    assert (rounded, limited) == ((), ("brake_front",))


@pytest.mark.parametrize(("front", "rear", "pedal"), [(50, 0, 100), (51, 0, 0), (0, 50, 100), (0, 51, 0), (51, 51, 0)])
def test_the_accelerator_is_closed_while_the_brakes_bite(front, rear, pedal):
    command, changed = LIMITS.apply(ActuatorPositions(0.0, 0.01, front * 1e3, rear * 1e3, 1), STILL)
    assert command.accelerator == pedal
    assert ("accelerator" in changed) == (pedal == 0)


def test_brakes_still_falling_keep_the_accelerator_closed():
    pressed = RawCommand(0, 0, 1300, 1300, 1)
    command, _ = LIMITS.apply(ActuatorPositions(0.0, 0.02, 0.0, 0.0, 1), pressed)
    assert (command.brake_front, command.accelerator) == (700, 0)
    command, _ = LIMITS.apply(ActuatorPositions(0.0, 0.02, 0.0, 0.0, 1), command)
    command, _ = LIMITS.apply(ActuatorPositions(0.0, 0.02, 0.0, 0.0, 1), command)
    assert (command.brake_front, command.accelerator) == (0, 200)


def test_the_accelerator_closes_at_once():
    command, _ = LIMITS.apply(REST, RawCommand(0, 10_000, 0, 0, 1))
    assert command.accelerator == 0


def test_from_rest_the_steering_starts_where_it_is():
    assert LIMITS.resting(math.radians(31.0)) == RawCommand(62, 0, 0, 0, 1)
    assert LIMITS.resting(math.radians(300.0)).steering_motor == 479
    assert LIMITS.resting(math.radians(-300.0)).steering_motor == -479


def test_raw_and_si_agree():
    sent = LIMITS.to_actuators(RawCommand(-20, 5000, 1000, 900, 4))
    assert sent == ActuatorPositions(pytest.approx(-math.radians(10)), pytest.approx(0.5), 1e6, 9e5, 4)


def test_limits_wider_than_the_field_stop_at_the_field():
    place = CAR.codec.signals.commands["steering_motor"]
    wide = _signal_limit("x", place, (-9e9, 9e9), (1.0, 1.0))
    assert (wide.low, wide.high) == (-1024, 1023)
    exact = _signal_limit("x", place, (math.radians(-2.0), math.radians(2.0)), (1.0, 1.0))
    assert (exact.low, exact.high) == (-4, 4)


@pytest.mark.parametrize(("rate", "steps"), [(500.0, 10), (499.9, 9), (200.0, 4)])
def test_rates_are_rounded_down_to_whole_steps(rate, steps):
    limit = Limits(CAR, LimitConfig(steering_rate=rate).within(CAR)).signals["steering_motor"]
    assert (limit.up, limit.down) == (steps, steps)


def test_a_signal_that_counts_the_other_way_rises_as_it_should_fall():
    """2000 - raw kPa: pressing hard counts down, letting go counts up."""
    place = CAR.codec.signals.commands["brake_front"]
    turned = replace(place, factor=-1e3, offset=2e6)
    limit = _signal_limit("x", turned, (0.0, 2e6), (180e6, 60e6))
    assert (limit.low, limit.high, limit.up, limit.down) == (0, 2000, 600, 1800)
    assert limit.apply(0.0, 1000) == 1600, "let go by 600 kPa"
    assert limit.apply(1e6, 2000) == 1000, "pressed by 1000 kPa"
    assert limit.value(1000) == pytest.approx(1e6)


def test_a_field_too_coarse_for_its_rate_is_refused():
    place = CAR.codec.signals.commands["brake_front"]
    with pytest.raises(InputError, match=r"brake_pressure_cmd\.F_brake_pressure_cmd: steps of 1e\+06"):
        _signal_limit("brake_front", replace(place, factor=1e6), (0.0, 6e6), (10e6, 10e6))


def test_where_the_rear_brakes_follow_the_front_ones_the_force_is_the_same():
    """A car with one command for both circuits: 54 % of the pressure is in front."""
    signals = CAR.codec.signals
    one = SimpleNamespace(commands={n: p for n, p in signals.commands.items() if n != "brake_rear"})
    car = SimpleNamespace(
        powertrain=CAR.powertrain, actuators=CAR.actuators, vehicle=CAR.vehicle, codec=SimpleNamespace(signals=one)
    )
    limits = Limits(car, LimitConfig().within(CAR))
    command, changed = limits.apply(REST._replace(brake_front=0.3e6, brake_rear=0.7e6), STILL)
    sent = limits.to_actuators(command)
    assert (command.brake_front, command.brake_rear, changed) == (540, 0, ())
    assert sent.brake_front + sent.brake_rear == pytest.approx(1.0e6)
