"""Fixes of receivers on the network: brought up to now, the receiver in use, and why there is none."""

from __future__ import annotations

import math

import pytest

from hil_gateway.bus.messages import Heading
from hil_gateway.bus.outside import Navigation, Place, Quality, Velocity
from hil_gateway.config import Config, load_config
from hil_gateway.gateway.perceive.positions.network import NetworkReceivers
from hil_gateway.track.geodesy import LocalMap

MS, START_MS = 1_000_000, 10_000
SPEED, GAIN, RATE = 60.0, -15.0, 0.4
"""m/s at the start, m/s2 and rad/s: hard on the brakes into a bend"""
NAMES = ("novatel_top", "novatel_bottom")


def config() -> Config:
    return load_config(None, {"receivers": {name: {"address": "tcp://127.0.0.1:1"} for name in NAMES}})


def true_way(ms: int) -> tuple[float, float, float, float]:
    """x, y, yaw, speed of the car so many ms after the start, in steps of 0.1 ms."""
    x = y = 0.0
    for step in range(10 * ms):
        t = (step + 0.5) * 1e-4
        x += 1e-4 * (SPEED + GAIN * t) * math.cos(RATE * t)
        y += 1e-4 * (SPEED + GAIN * t) * math.sin(RATE * t)
    return x, y, RATE * 1e-3 * ms, SPEED + GAIN * 1e-3 * ms


class Played:
    """What the gateway is given, ms by ms of a car on `true_way`."""

    def __init__(self, given: Config) -> None:
        self.map, self.receivers, self.seq = LocalMap(given.origin), NetworkReceivers(given), 0

    def say(self, name: str, of_ms: int, now_ms: int, quality: Quality = Quality.FIXED, **other: object) -> None:
        x, y, yaw, speed = true_way(of_ms)
        latitude, longitude = self.map.to_geodetic(x, y)
        place = Place(latitude=latitude, longitude=longitude, height=None, std_east=0.01, std_north=0.01, std_up=None)
        velocity = Velocity(east=speed * math.cos(yaw), north=speed * math.sin(yaw), up=None, std=0.02)
        said = {"place": place, "velocity": velocity, "places": True, "reason": "", **other}
        if quality is Quality.REFUSED:
            said |= {"place": None, "velocity": None, "reason": "no RTK (type 16)"}
        message = Navigation.model_validate({
            "stamp_ns": (START_MS + of_ms) * MS, "seq": self.seq, "source": name, "log": "INSPVAX", "quality": quality,
            "gps_ns": 0, "late_s": 0.0, **said,
        })  # fmt: skip
        self.seq += 1
        self.receivers.take([message], (START_MS + now_ms) * MS)

    def step(self, now_ms: int) -> tuple[float, float] | None:
        fix = self.receivers.step((START_MS + now_ms) * MS, GAIN, RATE)
        if fix is None:
            return None
        x, y = self.map.to_map(*fix[:2])
        return x + fix[2], y + fix[3]

    def in_use(self, now_ms: int) -> str:
        healths = self.receivers.healths((START_MS + now_ms) * MS)
        assert healths["position"] == healths[f"receiver.{self.receivers.name}"]
        return self.receivers.name


@pytest.mark.parametrize("late_ms", [0, 25, 80, 200])
def test_a_late_fix_is_one_of_now(late_ms):
    played = Played(config())
    for ms in range(0, 300, 10):
        assert played.step(ms) is None
    played.say("novatel_top", 300 - late_ms, 300)
    found = played.step(300)
    assert found == pytest.approx(true_way(300)[:2], abs=0.01)
    assert math.dist(true_way(300 - late_ms)[:2], true_way(300)[:2]) >= 0.05 * late_ms
    assert played.step(310) is None  # once


def test_a_fix_whose_velocity_is_older_goes_the_way_of_the_car_all_the_same():
    played = Played(config())
    for ms in range(0, 300, 10):
        played.step(ms)
    played.say("novatel_top", 180, 300, place=None, places=False)
    played.say("novatel_top", 220, 300, velocity=None)
    assert played.step(300) == pytest.approx(true_way(300)[:2], abs=0.01)


def test_antenna_ahead_of_the_centre_of_gravity_is_taken_off_by_where_the_car_points():
    played = Played(config())
    newest = played.receivers._newest["novatel_top"]
    newest.declared = newest.declared.model_copy(update={"x": 1.5, "y": -0.2})
    for ms in range(0, 300, 10):
        played.step(ms)
    played.say("novatel_top", 220, 300, heading=Heading(yaw=0.5, std=0.01))
    x, y = true_way(300)[:2]
    yaw = 0.5 + 0.08 * RATE
    ahead, left = 1.5, -0.2
    expected = x - math.cos(yaw) * ahead + math.sin(yaw) * left, y - math.sin(yaw) * ahead - math.cos(yaw) * left
    assert played.step(300) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("late_ms", [0, 80, 200])
def test_a_late_heading_has_turned_with_the_car(late_ms):
    played = Played(config())
    for ms in range(0, 300, 10):
        played.step(ms)
    played.say("novatel_top", 300 - late_ms, 300, heading=Heading(yaw=true_way(300 - late_ms)[2], std=0.002))
    played.step(300)
    found = played.receivers.heading((START_MS + 300) * MS)
    assert found is not None
    assert (found.yaw, found.std) == (pytest.approx(true_way(300)[2], abs=1e-3), 0.002)
    assert played.receivers.heading((START_MS + 300) * MS) is None  # once


def test_of_two_logs_that_say_where_the_car_points_one_is_used():
    """The line of the antennas, and the inertial unit, are not mounted alike."""
    played = Played(config())
    for ms in range(0, 400, 10):
        if ms % 50 == 0:
            played.say("novatel_top", ms, ms, heading=Heading(yaw=0.1, std=0.002))
        if ms >= 200:
            antennas = Heading(yaw=0.5, std=0.002)
            played.say("novatel_top", ms, ms, log="HEADING2", place=None, velocity=None, places=False, heading=antennas)
        played.step(ms)
        found = played.receivers.heading((START_MS + ms) * MS)
        assert found is None or abs(found.yaw - 0.1) < 0.1, ms


def test_a_heading_that_is_not_of_fixed_quality_is_left_out():
    played = Played(config())
    for ms in range(0, 300, 10):
        played.step(ms)
    played.say("novatel_top", 290, 300, Quality.DEGRADED, heading=Heading(yaw=0.1, std=0.002))
    played.step(300)
    assert played.receivers.heading((START_MS + 300) * MS) is None


def test_a_place_goes_on_by_the_stated_velocity_while_corrections_are_missing():
    """Half a second under a bridge; the velocity is of an inertial solution, 80 ms late, the last fix comes as late."""
    played, without = Played(config()), {"place": None, "places": False}
    for ms in range(0, 1000, 10):
        if ms >= 80:
            of_ms = ms - 80
            played.say("novatel_top", of_ms, ms, Quality.FIXED if of_ms <= 300 else Quality.DEGRADED, **without)
            if of_ms <= 300 and of_ms % 50 == 0:
                played.say("novatel_top", of_ms, ms, velocity=None)
        found = played.step(ms)
        played.in_use(ms)
        if found is not None:
            assert found == pytest.approx(true_way(ms)[:2], abs=0.02), ms
    assert found is not None or played.step(1000) is not None
    assert played.receivers.healths((START_MS + 1000) * MS)["position"].valid


@pytest.mark.parametrize("std", [0.5, None])
def test_a_place_goes_on_no_further_than_its_velocity_is_good_for(std):
    """0.1 m at 0.5 m/s; nothing where none is stated."""
    played, last = Played(config()), 0
    for ms in range(0, 1000, 10):
        _, _, yaw, speed = true_way(ms)
        velocity = Velocity(east=speed * math.cos(yaw), north=speed * math.sin(yaw), up=None, std=std)
        quality = Quality.FIXED if ms <= 300 else Quality.DEGRADED
        played.say("novatel_top", ms, ms, quality, velocity=velocity, place=None, places=False)
        if ms <= 300 and ms % 50 == 0:
            played.say("novatel_top", ms, ms, velocity=None)
        last = ms if played.step(ms) is not None else last
    assert 450 <= last <= 510 if std else last == 300


def test_receiver_in_use_stays_so_while_it_places_the_car():
    played = Played(config())
    assert played.in_use(0) == "novatel_top"
    for ms in range(0, 1000, 50):
        played.say("novatel_bottom", ms, ms)
        if not 200 <= ms < 600:
            played.say("novatel_top", ms, ms)
        played.step(ms)
        expected = "novatel_top" if ms < 400 else "novatel_bottom"
        assert played.in_use(ms) == expected, ms


def test_a_receiver_without_velocity_does_not_place_the_car_and_the_next_one_does():
    played = Played(config())
    for ms in range(0, 400, 50):
        played.say("novatel_top", ms, ms, velocity=None)
        played.say("novatel_bottom", ms, ms)
        played.step(ms)
    assert played.in_use(400) == "novatel_bottom"
    assert "novatel_top: no velocity comes with its positions" in played.receivers.cause


def test_without_a_fix_the_cause_of_each_is_said():
    played = Played(config())
    assert "hil receiver run" in played.receivers.cause
    for ms in range(0, 300, 10):
        played.step(ms)
    played.say("novatel_top", 290, 300, Quality.REFUSED)
    played.say("novatel_bottom", 290, 300, velocity=None)
    assert played.step(300) is None
    assert "novatel_top: no RTK (type 16)" in played.receivers.cause
    assert "novatel_bottom: no velocity comes with its positions" in played.receivers.cause
    assert not played.receivers.healths((START_MS + 900) * MS)["position"].valid


def test_what_is_of_another_clock_or_another_receiver_is_left_out():
    played = Played(config())
    for ms in range(0, 300, 10):
        played.step(ms)
    played.say("novatel_top", 500, 300)
    played.say("novatel_top", 200, 300 + 1500)
    played.say("somebody", 290, 300)
    assert played.step(300) is None
