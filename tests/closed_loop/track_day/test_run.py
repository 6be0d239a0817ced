"""A run in the whole loop: the plant's speed keeps to the cap, and the in lap ends where it is to end."""

from __future__ import annotations

from hil_gateway.bus import topics
from hil_gateway.bus.messages import FailsafeAction, PlanStatus
from hil_gateway.bus.track_day.run import RunAction, RunPhase, RunPlan, RunRequest, RunStatus
from hil_gateway.config import Config
from hil_gateway.track.loading import load_track
from planner.simulation.loop import Loop

CAP = 20.0
PLACE = 250.0
"""m along the oval, on its start straight"""


class Drive:
    def __init__(self) -> None:
        start_s = load_track("oval").length - 20.0
        config = Config.model_validate({"track": "oval", "plant": {"start_s": start_s}})
        self.loop = Loop(config, keep=(topics.RUN, topics.PLAN))
        self.asked, self.fastest = 0, 0.0

    def ask(self, action: RunAction, plan: RunPlan | None = None) -> None:
        self.asked += 1
        now_ns = self.loop.clock.now_ns()
        request = RunRequest(stamp_ns=now_ns, seq=self.asked, source="test", action=action, plan=plan)
        self.loop.bus.publish(topics.RUN_REQUEST, request)

    @property
    def status(self) -> RunStatus:
        return self.loop.result.messages[topics.RUN.key][-1]

    def go(self, seconds: float, until: RunPhase | None = None) -> None:
        until_s = self.loop.elapsed_s + seconds
        while self.loop.elapsed_s < until_s:
            self.loop.step()
            self.fastest = max(self.fastest, self.loop.plant.car["vx"])
            if until and self.loop.elapsed_s > until_s - seconds + 1.0 and self.status.phase is until:
                return


def test_the_cap_holds_and_the_in_lap_stops_at_its_place():
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=2, speed=(CAP,), stop_at=PLACE))
    drive.go(9.5)
    assert CAP - 0.5 < drive.fastest < CAP + 0.5 and drive.status.phase is RunPhase.OUT_LAP
    drive.ask(RunAction.IN)
    drive.go(30.0, until=RunPhase.DONE)
    car, plan = drive.loop.plant.car, drive.loop.result.messages[topics.PLAN.key][-1]
    assert drive.status.stop_at == PLACE
    assert drive.status.phase is RunPhase.DONE and drive.status.clean and drive.fastest < CAP + 0.5
    assert abs(car.road.s - PLACE) < 2.0
    assert plan.status is PlanStatus.NOT_MOVING and "hil run next" in plan.reason
    drive.go(2.0)
    assert drive.loop.gateway.failsafe.action is FailsafeAction.DRIVE and car.standing
    drive.ask(RunAction.NEXT)
    drive.go(3.0)
    assert car["vx"] > 5.0 and drive.status.phase is RunPhase.OUT_LAP and not drive.loop.result.failsafes
