"""Frames that waited somewhere: how late they are, and a stop that goes by them."""

from __future__ import annotations

import math

import pytest
from support.cars.scripted_car import PERIOD_NS, Rig

from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.lateness import Lateness, brought_up
from hil_gateway.gateway.perceive.motion import Motion

SILENT = 10
"""periods"""


class Bus:
    """A car whose frames are silent for `SILENT` periods; what came in them is lost, or comes afterwards."""

    def __init__(self) -> None:
        self.rig = Rig()
        self.late = Lateness(self.rig.gateway.builder)
        self.waiting: list = []
        self.rig.car.link = self  # the car sends through here
        self._link = self.rig.wire.link()
        self.held = 0
        self.lost = False

    def receive(self) -> list:
        return self._link.receive()

    def send(self, *frame: object) -> None:
        if not self.lost:
            self.waiting.append((self.rig.tick + self.held, frame))

    def period(self) -> int:
        """One period of the car; how late its frames are, ns."""
        self.rig.car.step(self.rig.now_ns)
        due = [frame for tick, frame in self.waiting if tick <= self.rig.tick]
        self.waiting = [entry for entry in self.waiting if entry[0] > self.rig.tick]
        for frame in due:
            self._link.send(*frame)
        self.rig.gateway.step(self.rig.now_ns)
        late_ns = self.late.step(self.rig.now_ns)
        self.rig.clock.advance(PERIOD_NS)
        self.rig.tick += 1
        return late_ns

    def periods(self, count: int) -> list[int]:
        return [self.period() for _ in range(count)]


@pytest.fixture
def bus() -> Bus:
    made = Bus()
    made.periods(50)
    return made


def test_frames_that_wait_are_late_by_as_long(bus):
    bus.held = SILENT
    late = bus.periods(3 * SILENT)
    assert not any(late[:SILENT])
    assert late[-1] == pytest.approx(SILENT * PERIOD_NS, abs=PERIOD_NS)


def test_after_frames_that_are_lost_the_next_ones_are_in_time(bus):
    bus.lost = True
    bus.periods(SILENT)
    bus.lost = False
    assert not any(bus.periods(3 * SILENT))


def test_frames_that_come_all_at_once_afterwards_have_caught_up(bus):
    bus.held = SILENT
    bus.periods(SILENT)
    bus.held, bus.waiting = 0, [(0, frame) for _, frame in bus.waiting]
    assert not any(bus.periods(3 * SILENT)[1:])


@pytest.mark.parametrize("first", [True, False], ids=["reader first", "car first"])
def test_a_reader_that_was_held_up_together_with_the_car_finds_nothing_late(first):
    """As in a simulation of which all processes sleep; the reader may be awake a period before the car."""
    rig = Rig()
    rig.drive = 0.3
    rig.drive_off(8.0)
    rig.clock.advance(100 * PERIOD_NS)
    if first:
        rig.gateway.step(rig.now_ns)
        rig.clock.advance(PERIOD_NS)
    rig.run(0.05)
    assert rig.action is FailsafeAction.EMERGENCY_STOP
    assert rig.gateway.speed == pytest.approx(rig.car.speed, abs=3.0)
    assert abs(rig.gateway._dead_reckoning.pose.x - rig.car.x) < 1.0


def test_what_is_forgotten_is_not_late_until_the_next_silence(bus):
    bus.held = SILENT
    assert bus.periods(2 * SILENT)[-1] > 0
    bus.late.forget()
    assert not any(bus.periods(20))


def test_a_car_goes_on_as_it_went_while_its_frames_are_on_their_way():
    motion, pose = brought_up(Motion(40.0, 0.1), Pose(10.0, 5.0, 0.5, 40.0), -10.0, 0.2, 0.1)
    assert (motion.speed, motion.yaw_rate) == pytest.approx((39.0, 0.3))
    assert pose.yaw == pytest.approx(0.52)
    assert (pose.x, pose.y) == pytest.approx((10.0 + 3.95 * math.cos(0.51), 5.0 + 3.95 * math.sin(0.51)), abs=1e-3)


def test_a_stop_with_late_frames_goes_by_where_the_car_is_now():
    """Not by where its fixes say it was."""
    rig = Rig()
    rig.drive = 0.3
    rig.drive_off(8.0)
    link, waiting = rig.car.link, []

    class Held:
        receive = staticmethod(link.receive)

        @staticmethod
        def send(*frame: object) -> None:
            waiting.append((rig.tick + SILENT, frame))

    def release(_: Rig) -> None:
        for entry in [entry for entry in waiting if entry[0] <= rig.tick + 1]:
            waiting.remove(entry)
            link.send(*entry[1])

    rig.car.link, rig.estimator_runs = Held, False
    rig.hooks.append(release)
    seen: list[float] = []
    act = rig.gateway._act
    rig.gateway._act = lambda now_ns, state, motion, pose: (
        seen.append(pose.x - rig.car.x),
        act(now_ns, state, motion, pose),
    )
    rig.run(0.8)
    assert rig.action is FailsafeAction.EMERGENCY_STOP
    assert rig.car.speed > 40.0, "0.1 s of its way are metres"
    assert max(map(abs, seen[-40:])) < 0.4, "its wheels roll without the slip that brakes make"
