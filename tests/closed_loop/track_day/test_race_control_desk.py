"""Flags and speeds as a person at the desk asks for them reach the car over its bus, and the loop obeys them."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner

from hil_gateway.bus import topics, zenoh_bus
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.bus.track_day.race_control import RaceControlRequest
from hil_gateway.car.states import TrackFlag, VehicleFlag
from hil_gateway.cli.main import app
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from planner.simulation.loop import Loop


class Desk:
    """A loop with a person who shows flags and arms again."""

    def __init__(self) -> None:
        self.loop = Loop(Config(), keep=(topics.RACE_CONTROL,))
        self.loop.run(seconds=6.5, time_limit_s=40.0)

    def show(self, seconds: float, **change: Any) -> None:
        now_ns = self.loop.clock.now_ns()
        request = RaceControlRequest(stamp_ns=now_ns, seq=now_ns // 1000, source="test", **change)
        self.loop.bus.publish(topics.RACE_CONTROL_REQUEST, request)
        self.go(seconds)

    def go(self, seconds: float) -> None:
        until_s = self.loop.elapsed_s + seconds
        while self.loop.elapsed_s < until_s:
            self.loop.step()

    @property
    def speed(self) -> float:
        return self.loop.plant.car["vx"]

    @property
    def doing(self) -> tuple[FailsafeAction, str]:
        return self.loop.gateway.failsafe.action, self.loop.gateway.failsafe.cause


def test_yellow_red_green_and_purple_end_as_the_table_says():
    desk = Desk()
    assert desk.speed > 15.0
    desk.show(5.0, track_flag=TrackFlag.FULL_COURSE_YELLOW, target_speed=12.0)
    assert 11.0 < desk.speed < 12.5 and desk.doing == (FailsafeAction.DRIVE, "")
    desk.show(2.5, track_flag=TrackFlag.GREEN, target_speed=0.0)
    assert desk.speed > 13.0
    desk.show(6.0, track_flag=TrackFlag.RED)
    assert desk.doing == (FailsafeAction.CONTROLLED_STOP, "track_flag_stop") and desk.loop.plant.car.standing
    desk.show(1.0, track_flag=TrackFlag.GREEN)
    assert desk.loop.plant.car.standing
    desk.loop.ask(OperatorAction.ARM)
    desk.go(3.0)
    assert desk.doing == (FailsafeAction.DRIVE, "") and desk.speed > 5.0
    desk.show(3.0, vehicle_flag=VehicleFlag.PURPLE)
    assert desk.doing == (FailsafeAction.EMERGENCY_STOP, "vehicle_flag_kill") and desk.loop.plant.car.standing
    assert desk.loop.plant.controller.state == 16
    last = desk.loop.result.messages[topics.RACE_CONTROL.key][-1]
    assert (last.track_flag, last.vehicle_flag) == (TrackFlag.GREEN, VehicleFlag.PURPLE)


def test_where_no_simulated_car_answers_nothing_is_sent(monkeypatch):
    bus = LocalBus()
    monkeypatch.setattr(zenoh_bus, "open_bus", lambda config, name: bus)
    monkeypatch.setattr(bus, "close", lambda: None)
    sent = bus.subscribe(topics.RACE_CONTROL_REQUEST, depth=8)
    done = CliRunner().invoke(app, ["race-control", "flag", "red"])
    assert isinstance(done.exception, InputError) and "no simulated car answers" in str(done.exception)
    assert sent.poll(0) == []
