"""Requests of a person at the planner: each is taken once, however often it is delivered."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.track_day.run import RunAction, RunPhase, RunPlan, RunRequest
from hil_gateway.track.loading import load_track
from planner.run.desk import RunDesk
from planner.run.expansion import Expansion
from planner.run.progress import Progress


def test_a_request_that_arrives_several_times_at_once_begins_one_run_and_is_not_refused() -> None:
    """It is sent every 0.1 s until it is answered, also to a planner that is held up."""
    bus, track = LocalBus(), load_track("oval")
    answers = bus.subscribe(topics.RUN)
    base: Any = SimpleNamespace(line=SimpleNamespace(track_s=track.s, s=np.array(track.s)))
    desk = RunDesk(bus, Progress(track.length, "car", Expansion()), track, None)
    request = RunRequest(stamp_ns=1, seq=1, source="cli", action=RunAction.START, plan=RunPlan(stop_at=600.0))
    for _ in range(3):
        bus.publish(topics.RUN_REQUEST, request)
    desk.step(10**9, 10.0, base)
    answer = answers.poll(10**9)[-1]
    assert (answer.answered, answer.refused, answer.phase, answer.number) == ("cli", "", RunPhase.OUT_LAP, 1)
