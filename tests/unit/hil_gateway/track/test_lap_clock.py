"""Lap times from positions: exact for a car of constant speed, whatever the sampling; nothing is invented."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_gateway.track.lap_clock import SECTORS, LapClock

LENGTH = 3000.0


def drive(clock: LapClock, speed: float, seconds: float, step_s: float = 0.1, *, start: float = 0.0, t0: float = 0.0):
    for i in range(round(seconds / step_s) + 1):
        clock.update(t0 + i * step_s, (start + speed * i * step_s) % LENGTH, speed)
    return clock


@settings(max_examples=30)
@given(speed=st.floats(10, 90), step_s=st.floats(0.01, 0.3))
def test_laps_of_a_constant_speed_take_length_over_speed(speed, step_s):
    clock = drive(LapClock(LENGTH), speed, 3.5 * LENGTH / speed, step_s)
    assert len(clock.laps) == 3
    for lap in clock.laps:
        assert lap.time_s == pytest.approx(LENGTH / speed, rel=1e-6, abs=1e-6)
        assert lap.sectors_s == pytest.approx([lap.time_s / SECTORS] * SECTORS)


def test_a_lap_that_began_elsewhere_than_at_the_line_has_no_time():
    assert drive(LapClock(LENGTH), 50.0, 30.0, start=2000.0).laps == []


def test_the_delta_to_the_best_lap_grows_with_what_is_lost():
    clock = drive(LapClock(LENGTH), 60.0, LENGTH / 60.0 + 1.05, start=LENGTH - 60.0)
    start = clock.laps[0].start_s + clock.laps[0].time_s
    for i in range(1, 300):
        t = start + 0.1 * i
        clock.update(t, 50.0 * 0.1 * i, 50.0)
    assert clock.delta_s(t, 50.0 * 29.9) == pytest.approx(29.9 - 50.0 * 29.9 / 60.0, abs=0.02)


def test_a_jump_of_the_position_ends_the_lap_without_a_time():
    clock = drive(LapClock(LENGTH), 50.0, 20.0)
    assert clock.current_s(20.0) == 20.0
    clock.update(20.1, 2500.0, 50.0)
    drive(clock, 50.0, 12.0, start=2505.0, t0=20.2)
    assert clock.laps == []


def test_a_car_that_stands_on_the_line_begins_its_lap_when_it_moves():
    clock = LapClock(LENGTH)
    for i in range(100):
        clock.update(0.1 * i, 2.0, 0.0)
    drive(clock, 50.0, 61.0, start=2.0, t0=10.0)
    drive(clock, 50.0, 61.0, start=52.0, t0=71.1)
    assert clock.laps[0].time_s == pytest.approx((LENGTH - 2.0) / 50.0, abs=0.11)
    assert [lap.from_rest for lap in clock.laps] == [True, False]


def test_a_position_that_wavers_across_the_line_while_the_car_stands_begins_no_lap():
    clock = LapClock(LENGTH)
    for i in range(100):
        clock.update(0.1 * i, (LENGTH - 0.1) if i % 2 else 0.1, 0.0)
    assert clock.current_s(10.0) is None
    drive(clock, 50.0, 61.0, start=0.1, t0=10.0)
    assert clock.laps[0].time_s == pytest.approx(LENGTH / 50.0, abs=0.11)


def test_a_car_that_is_pushed_to_its_place_begins_its_lap_when_it_drives_off():
    clock = drive(LapClock(LENGTH), 1.0, 6.0)
    for i in range(300):
        clock.update(6.1 + 0.1 * i, 6.0, 0.0)
    drive(clock, 50.0, 61.0, start=6.0, t0=36.1)
    assert clock.laps[0].time_s == pytest.approx((LENGTH - 6.0) / 50.0, abs=0.11)


def test_a_lap_from_rest_begins_at_the_same_moment_whatever_the_sampling():
    def began(step_s: float) -> float:
        clock = LapClock(LENGTH)
        for i in range(round(100.0 / step_s)):
            t = i * step_s
            clock.update(t, 2.0 + 1.5 * max(t - 5.03, 0.0) ** 2, 3.0 * max(t - 5.03, 0.0))
        return clock.laps[0].start_s

    assert began(0.1) == pytest.approx(began(0.01), abs=0.02)
