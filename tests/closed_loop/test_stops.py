"""Whatever makes the gateway stop the car, the car stays on the track while it brakes: with the real planner, estimator
and plant, from many places of the road course."""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from support.promise_figures import record_figure, volume

from estimator.node import Estimator
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import OperatorAction, OperatorCommand, VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.node import OrderlyEnd
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track
from planner.simulation.loop import Faults, Loop

REASONS = ("planner", "estimator", "planner and estimator", "stop", "emergency", "heartbeat", "purple")


class Dead(Faults):
    """Components that no longer run."""

    def __init__(self) -> None:
        self.components: set[str] = set()

    def runs(self, now_ns: int, component: str) -> bool:
        return component not in self.components


def stop_for(loop: Loop, dead: Dead, reason: str) -> dict[str, Any]:
    """Bring the reason about and run until the car stands."""
    loop.plant.referee.worst_margin_m = float("inf")
    begin_s, begin_m, speed = loop.elapsed_s, loop.plant.referee.distance_m, loop.plant.car["vx"]
    if reason in ("stop", "emergency"):
        action = OperatorAction(reason)
        message = OperatorCommand(stamp_ns=loop.clock.now_ns(), seq=10**6, source="test", action=action)
        loop.bus.publish(topics.OPERATOR, message)
    elif reason == "heartbeat":
        loop.plant.race_control.beating = False
    elif reason == "purple":
        loop.plant.race_control.vehicle_flag = 32
    else:
        dead.components = set(reason.split(" and "))
    while not loop.plant.car.standing and loop.elapsed_s < begin_s + 25.0:
        loop.step()
    return {
        "reason": reason,
        "at_s": begin_s,
        "speed": speed,
        "stands": bool(loop.plant.car.standing),
        "metres": loop.plant.referee.distance_m - begin_m,
        "margin": loop.plant.referee.worst_margin_m,
        "action": loop.gateway.failsafe.action.value,
        "cause": loop.gateway.failsafe.cause,
    }


def in_a_fork(work: Callable[[], Any]) -> Any:
    """What `work` returns, done in a copy of this process."""
    reader, writer = os.pipe()
    if not (pid := os.fork()):
        try:
            os.write(writer, json.dumps(work()).encode())
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        text = pipe.read()
    os.waitpid(pid, 0)
    return json.loads(text)


def stops(points: int, spacing_s: float) -> Iterator[dict[str, Any]]:
    """Every reason from every point, each in a forked copy of the running loop."""
    dead = Dead()
    loop = Loop(Config.model_validate({"planner": {"horizon": 20}}), faults=dead)
    loop.run(seconds=8.0, time_limit_s=60.0)
    for point in range(points):
        for reason in REASONS:
            yield in_a_fork(partial(stop_for, loop, dead, reason))
        if point < points - 1:
            until_s = loop.elapsed_s + spacing_s
            while loop.elapsed_s < until_s:
                loop.step()


@pytest.mark.long
def test_a_drive_of_laps_ends_where_the_car_stands_after_a_stop():
    dead = Dead()
    loop = Loop(Config.model_validate({"planner": {"horizon": 20}}), faults=dead)
    loop.run(seconds=4.0)
    dead.components = {"planner"}
    result = loop.run(laps=1, time_limit_s=60.0)
    assert result.failsafes and loop.plant.car.standing
    assert loop.elapsed_s < 40.0, "nobody arms again: the rest of the time tells nothing"


@pytest.mark.slow
@pytest.mark.promise("L5")
@pytest.mark.parametrize("requests", [1, 2])
def test_a_gateway_that_is_to_end_in_a_bend_keeps_the_car_on_the_road_unless_it_must_hurry(bend: Loop, requests: int):
    margin, cause = in_a_fork(lambda: end_in(bend, requests))
    if requests == 1:
        assert (margin > 0, cause) == (True, "gateway_ending")
    else:
        assert margin < 0, "without the stop this bend takes the car off the road: else it proves nothing"


@pytest.fixture(scope="module")
def bend() -> Loop:
    """The first fast bend of the road course, with the lateral force just there."""
    loop = Loop(Config.model_validate({"planner": {"horizon": 20}}), faults=Dead())
    while not (loop.plant.car["vx"] > 60 and abs(loop.gateway.seen[0].ay) > 9):
        loop.step()
        assert loop.elapsed_s < 60
    return loop


def end_in(loop: Loop, requests: int) -> tuple[float, str]:
    """Least distance of a wheel to the edge (m) until the car stands, gateway ended, and the cause of its stop."""
    end, begin_s = OrderlyEnd(loop.gateway, Config().gateway.stop.controlled_deceleration), loop.elapsed_s
    loop.plant.referee.worst_margin_m = float("inf")
    while not end.over(loop.clock.now_ns(), requests):
        loop.step()
    loop.gateway.shut_down(loop.clock.now_ns())
    loop.faults.components = {"gateway"}
    while not loop.plant.car.standing and loop.elapsed_s < begin_s + 25.0:
        loop.step()
    assert loop.plant.car.standing
    return loop.plant.referee.worst_margin_m, loop.gateway.failsafe.cause


@pytest.mark.slow
@pytest.mark.promise("L1")
def test_a_computer_that_slept_in_a_bend_with_its_car_keeps_it_on_the_road(bend: Loop):
    margin, cause = in_a_fork(lambda: wake_in(bend, 1.5))
    assert margin > 0.0
    assert cause == "gateway_late"


def wake_in(loop: Loop, seconds: float) -> tuple[float, str]:
    """Least distance of a wheel to the edge (m) until the car stands, and the cause of its stop."""
    loop.clock.advance(round(seconds * 20) * NS_PER_S // 20)
    begin_s, loop.plant.referee.worst_margin_m = loop.elapsed_s, float("inf")
    while not loop.plant.car.standing and loop.elapsed_s < begin_s + 25.0:
        loop.step()
    assert loop.plant.car.standing
    return loop.plant.referee.worst_margin_m, loop.gateway.failsafe.cause


class Waited:
    """What came while nobody looked, given oldest first and twenty at a time, as a network and a busy process do."""

    dropped = 0

    def __init__(self, bus: LocalBus) -> None:
        self._states, self._left = bus.subscribe(topics.VEHICLE_STATE, depth=10_000), deque[VehicleState]()

    def poll(self, now_ns: int) -> list[VehicleState]:
        self._left += self._states.poll(now_ns)
        return [self._left.popleft() for _ in range(min(20, len(self._left)))]


def behind_a_network(config: Config, bus: LocalBus, track: Track) -> Estimator:
    estimator = Estimator(config, bus, track)
    estimator._states = Waited(bus)
    return estimator


@pytest.mark.slow
@pytest.mark.promise("L1")
@pytest.mark.parametrize("seconds", [0.7, 3.0])
def test_an_estimator_that_answers_what_waited_for_it_does_not_lead_a_stop(seconds: float):
    dead = Dead()
    made = Config.model_validate({"planner": {"horizon": 20}})
    loop = Loop(made, faults=dead, components={"estimator": behind_a_network})
    loop.run(seconds=8.0, time_limit_s=60.0)
    loop.plant.referee.worst_margin_m, begin_s = float("inf"), loop.elapsed_s
    dead.components = {"estimator"}
    while not loop.plant.car.standing and loop.elapsed_s < begin_s + 25.0:
        dead.components = dead.components if loop.elapsed_s < begin_s + seconds else set()
        loop.step()
        pose, car = loop.gateway._dead_reckoning.pose, loop.plant.car
        assert math.hypot(pose.x - car["x"], pose.y - car["y"]) < 1.0, loop.elapsed_s - begin_s
    assert loop.plant.car.standing and loop.plant.referee.worst_margin_m > 0.0


@pytest.mark.slow
@pytest.mark.promise("L1")
def test_every_stop_keeps_the_car_on_the_track():
    worst, count, kinds = float("inf"), 0, set()
    for result in stops(volume(1, 40), volume(5, 2)):
        assert result["stands"], result
        assert result["margin"] > 0, f"a wheel left the road: {result}"
        worst, count = min(worst, result["margin"]), count + 1
        kinds.add(result["action"])
    assert kinds == {"controlled_stop", "emergency_stop"}
    record_figure("L1", f"{count} stops at speed for {len(REASONS)} reasons: all on the track, {worst:.2f} m to spare")
