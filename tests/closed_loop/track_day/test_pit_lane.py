"""Into the box, out of it, around and in again, in the whole loop: judged by the plant's own state and the track."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import pytest
from support.promise_figures import record_figure

from hil_gateway.bus import topics
from hil_gateway.bus.messages import FailsafeAction, Message
from hil_gateway.bus.topics import Topic
from hil_gateway.bus.track_day.race_control import RaceControlRequest
from hil_gateway.bus.track_day.run import RunAction, RunPhase, RunPlan, RunRequest, RunStatus
from hil_gateway.car.states import VehicleFlag
from hil_gateway.config import Config
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import PitLane
from planner.run.progress import Progress
from planner.simulation.loop import Faults, Loop

BOX = 3


class Mute(Faults):
    """Messages of one topic are lost from a moment on."""

    def __init__(self) -> None:
        self.key = ""

    def messages(self, now_ns: int, topic: Topic[Any], message: Message) -> Iterable[tuple[int, Message]]:
        return () if topic.key == self.key else ((now_ns, message),)


class Drive:
    """A car 900 m before the line, with its box ahead."""

    def __init__(self, track: str = "oval") -> None:
        self.track, self.mute = load_track(track), Mute()
        config = Config.model_validate({"track": track, "plant": {"start_s": self.track.length - 900.0}})
        self.loop = Loop(config, keep=(topics.RUN,), faults=self.mute)
        self.asked, self.fastest = 0, 0.0

    @property
    def lane(self) -> PitLane:
        assert self.track.pit_lane is not None
        return self.track.pit_lane

    @property
    def status(self) -> RunStatus:
        return self.loop.result.messages[topics.RUN.key][-1]

    @property
    def limited(self) -> bool:
        """Whether the car is in the lane where its speed limit holds."""
        road, (begin, end) = self.loop.plant.car.road, self.lane.limit
        in_lane = self.track.room(road.s, road.lateral).in_lane
        return bool(in_lane and begin <= self.lane.along(road.s, self.track.length) <= end)

    def ask(self, action: RunAction, plan: RunPlan | None = None) -> None:
        self.asked += 1
        now_ns = self.loop.clock.now_ns()
        request = RunRequest(stamp_ns=now_ns, seq=self.asked, source="test", action=action, plan=plan)
        self.loop.bus.publish(topics.RUN_REQUEST, request)
        self.go(0.5)

    def show(self, flag: VehicleFlag) -> None:
        """Race control's flag for this car."""
        now_ns = self.loop.clock.now_ns()
        request = RaceControlRequest(stamp_ns=now_ns, seq=now_ns // 1000, source="test", vehicle_flag=flag)
        self.loop.bus.publish(topics.RACE_CONTROL_REQUEST, request)
        self.go(0.5)

    def go(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """On; `fastest` is the greatest speed in the limited lane."""
        until_s = self.loop.elapsed_s + seconds
        while self.loop.elapsed_s < until_s:
            if until is not None and until():
                return
            self.loop.step()
            if self.limited:
                self.fastest = max(self.fastest, self.loop.plant.car["vx"])
        assert until is None, f"not within {seconds} s: {self.status}"

    def assert_in_box(self) -> None:
        car = self.loop.plant.car
        x, y, yaw = self.track.box_pose(self.lane.boxes[BOX - 1])
        beside = math.hypot(car["x"] - x, car["y"] - y)
        turned = math.degrees(math.remainder(car["yaw"] - yaw, math.tau))
        assert beside < 0.3 and abs(turned) < 2.0, (beside, turned)
        assert car.standing and self.loop.gateway.failsafe.action is FailsafeAction.DRIVE
        figure = f"{beside:.2f} m, {turned:.1f} degrees; {self.fastest:.2f} m/s in the lane"
        record_figure("G3", f"{self.track.name}, box {BOX}: {figure}")


@pytest.mark.long
@pytest.mark.parametrize("track", ["oval", "tri_oval", "road_course"])
def test_a_car_keeps_to_the_pit_speed_and_stops_in_its_box_out_of_which_it_drives_again(track: str) -> None:
    drive = Drive(track)
    drive.ask(RunAction.START, RunPlan(laps=5, speed=(60.0,), load_use=(0.8,), box=BOX))
    for _ in range(2):
        drive.ask(RunAction.IN)
        drive.go(120.0, until=lambda: drive.status.phase is RunPhase.DONE)
        drive.go(1.0)
        drive.assert_in_box()
        assert drive.status.box == BOX and drive.status.in_pit_lane and drive.status.clean
        assert drive.lane.speed - 1.0 < drive.fastest < drive.lane.speed + 0.5
        drive.ask(RunAction.NEXT)
        drive.fastest = 0.0
        drive.go(40.0, until=lambda: not drive.status.in_pit_lane)
        assert drive.lane.speed - 1.0 < drive.fastest < drive.lane.speed + 0.5
    assert drive.loop.plant.referee.off_track_count == 0 and not drive.loop.result.failsafes


@pytest.mark.long
def test_a_black_flag_brings_the_car_into_its_box_and_keeps_it_there() -> None:
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=5, speed=(60.0,), load_use=(0.8,), box=BOX))
    drive.go(3.0)
    drive.show(VehicleFlag.BLACK)
    assert drive.status.phase is RunPhase.IN_LAP and drive.loop.gateway.failsafe.action is FailsafeAction.DRIVE
    drive.go(100.0, until=lambda: drive.status.phase is RunPhase.DONE)
    drive.go(1.0)
    drive.assert_in_box()
    drive.ask(RunAction.NEXT)
    drive.go(1.0)
    assert drive.status.refused == "black flag of race control" and drive.loop.plant.car.standing
    drive.show(VehicleFlag.NONE)
    drive.ask(RunAction.NEXT)
    drive.go(3.0)
    assert drive.loop.plant.car["vx"] > 5.0 and not drive.loop.result.failsafes


@pytest.fixture
def on_its_way() -> Drive:
    """A car in a run that would end in a box."""
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=5, box=BOX))
    drive.go(8.0)
    assert drive.status.phase is RunPhase.OUT_LAP and drive.loop.plant.car["vx"] > 5.0
    return drive


def test_a_planner_that_ignores_a_black_flag_is_stopped_on_the_road_a_second_later(
    on_its_way: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Progress, "come_in", lambda self, why: None)
    on_its_way.show(VehicleFlag.BLACK)  # half a second
    assert on_its_way.loop.gateway.failsafe.action is FailsafeAction.DRIVE
    on_its_way.go(0.7)
    assert on_its_way.loop.gateway.failsafe.cause == "vehicle_flag_stop"
    on_its_way.go(20.0, until=lambda: on_its_way.loop.plant.car.standing)
    assert on_its_way.loop.plant.referee.off_track_count == 0


def test_an_in_lap_that_is_not_reported_any_more_ends_on_the_road(on_its_way: Drive) -> None:
    on_its_way.show(VehicleFlag.BLACK)
    on_its_way.go(3.0)
    assert on_its_way.status.phase is RunPhase.IN_LAP
    assert on_its_way.loop.gateway.failsafe.action is FailsafeAction.DRIVE
    on_its_way.mute.key = topics.RUN.key
    on_its_way.go(1.1)
    assert on_its_way.loop.gateway.failsafe.cause == "vehicle_flag_stop"
    on_its_way.go(20.0, until=lambda: on_its_way.loop.plant.car.standing)
    assert on_its_way.loop.plant.referee.off_track_count == 0


def test_without_a_box_a_black_flag_stops_the_car_here() -> None:
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(stop_at=600.0))
    drive.go(3.0)
    drive.show(VehicleFlag.BLACK)
    assert drive.loop.gateway.failsafe.cause == "vehicle_flag_stop"
