"""A person takes over by a joystick, and gives the right to command to another planner: on the virtual clock."""

from __future__ import annotations

import pytest

from hil_gateway.bus import topics
from hil_gateway.bus.messages import Command, FailsafeAction, OperatorAction, OperatorCommand
from hil_gateway.config import Config
from planner.simulation.loop import Loop

pytestmark = pytest.mark.slow


class Second:
    """Repeats the planner's commands under another name, `scale` times its drive."""

    def __init__(self, loop: Loop, topic, source: str, scale: float = 1.0) -> None:
        self._loop, self._topic, self._source, self._scale = loop, topic, source, scale
        self._heard = loop.bus.subscribe(topics.COMMAND, depth=8)

    def run(self, seconds: float) -> None:
        until = self._loop.elapsed_s + seconds
        while self._loop.elapsed_s < until:
            self._loop.step()
            for c in self._heard.poll(self._loop.clock.now_ns()):
                if c.source != self._source:
                    own = {"source": self._source, "drive": self._scale * c.drive}
                    self._loop.bus.publish(self._topic, Command.model_validate({**c.model_dump(), **own}))


@pytest.fixture
def loop() -> Loop:
    driving = Loop(Config.model_validate({"planner": {"horizon": 20}}))
    driving.run(seconds=4.0, time_limit_s=60.0)
    assert driving.gateway.failsafe.action is FailsafeAction.DRIVE
    return driving


def test_a_person_takes_over_at_once_and_who_lets_go_stops(loop):
    planner = loop.gateway.inbox.command_source
    Second(loop, topics.JOYSTICK_COMMAND, "joystick 1", scale=0.5).run(1.0)
    assert (loop.gateway.inbox.command_source, loop.gateway.inbox.second_source) == ("joystick 1", planner)
    assert loop.gateway.failsafe.action is FailsafeAction.DRIVE
    loop.run(seconds=20.0, time_limit_s=60.0)
    assert loop.plant.car.standing and loop.gateway.failsafe.cause == "command_dead"
    assert loop.plant.referee.worst_margin_m > 0.0
    assert loop.gateway.inbox.command_source == "joystick 1", "the planner does not drive on by itself"


def test_another_planner_is_refused_until_a_person_gives_it_the_right(loop):
    planner, other = loop.gateway.inbox.command_source, Second(loop, topics.COMMAND, "planner 2")
    other.run(1.0)
    assert (loop.gateway.inbox.command_source, loop.gateway.inbox.second_source) == (planner, "planner 2")
    ask = OperatorCommand(stamp_ns=loop.clock.now_ns(), seq=1, source="test", action=OperatorAction.TAKE_OVER)
    for _ in range(2):  # a request that is delivered twice gives nothing back
        loop.bus.publish(topics.OPERATOR, ask)
        other.run(0.5)
    assert (loop.gateway.inbox.command_source, loop.gateway.inbox.second_source) == ("planner 2", planner)
    assert loop.gateway.failsafe.action is FailsafeAction.DRIVE
