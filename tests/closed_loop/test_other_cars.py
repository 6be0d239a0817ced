"""Cars that are only a folder of data: driven on the virtual clock by a simple planner, checked and stopped."""

from __future__ import annotations

import pytest
from support.examples import load_example

from can_dbc.folder import platforms
from hil_gateway.bus.messages import Estimate, OperatorAction
from hil_gateway.bus.topics import ESTIMATE
from hil_gateway.can_link import LinkStats
from hil_gateway.config import Config
from hil_gateway.gateway.check.run import Capture, examine
from planner.simulation.loop import START_NS, Loop

IN_THE_BEND = 400.0
"""m along the oval: whoever steers the wrong way is off its road within seconds"""


@pytest.mark.parametrize("platform", platforms())
def test_every_shipped_car_drives_round_a_bend_passes_the_check_and_stops(
    platform: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_PLATFORM", platform)
    config = Config.model_validate({"track": "oval", "plant": {"start_s": IN_THE_BEND}})
    loop = Loop(config, keep=(ESTIMATE,), components={"planner": load_example("my_planner").MyPlanner})
    tap = loop.wire.link()
    result = loop.run(seconds=7.0, time_limit_s=14.0)
    car, estimate = loop.plant.car, result.messages[ESTIMATE.key][-1]
    assert isinstance(estimate, Estimate)
    assert (result.armed, result.failsafes, result.off_track) == (True, [], 0)
    assert car["vx"] == pytest.approx(10.0, abs=1.0)
    assert abs(car["yaw_rate"]) > 0.03, "it is in a bend"
    assert abs(car.road.lateral) < 1.0
    assert (estimate.vx, estimate.yaw_rate) == pytest.approx((car["vx"], car["yaw_rate"]), abs=0.2)

    frames = [frame for frame in tap.receive() if not frame.is_error]
    report = examine(config, "wire", None, Capture(frames, START_NS, loop.clock.now_ns(), None, LinkStats()))
    assert [finding for finding in report.findings if finding.verdict == "fail"] == []
    assert report.unknown == {}

    loop.ask(OperatorAction.EMERGENCY)
    before = car["vx"]
    for _ in range(100):
        loop.step()
    assert before - car["vx"] > 5.0, "its brakes are those that were asked for"
