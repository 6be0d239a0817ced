"""The car placed by receivers on the network, without a position on CAN; judged by the plant's truth."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from estimator.replay import OUTPUTS, compare, replay_estimator
from hil_gateway.bus import topics
from hil_gateway.bus.messages import Estimate, GatewayStatus, VehicleState
from hil_gateway.config import Config, load_config
from hil_gateway.gateway.events.log import EventLog
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.plant.events import RtkEvent
from hil_gateway.session.files.configuration import required_config
from hil_gateway.session.files.format import session_metadata
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionWriter
from hil_gateway.session.recorder import Recorder
from planner.simulation.loop import Loop

UNIX_NS = 1_700_000_000 * 10**9
LOST_S = 9.0
"""after the car first moved: it goes into the first bend of the oval"""


def config() -> Config:
    read = {"address": "tcp://127.0.0.1:3001", "clock": "gps"}
    given = {"track": "oval", "receivers": {"novatel_top": read}, "plant.receivers": True, "plant.can_positions": False}
    return load_config(None, given)


class Drive:
    """A recorded drive that loses RTK for good; errors of the estimate by the truth while it was there, m and rad."""

    def __init__(self, path: Path) -> None:
        given = config()
        car = SimulatedCar(events=(RtkEvent(kind="rtk", t=LOST_S, for_s=60.0),))
        self.loop = loop = Loop(
            given, simulated=car, keep=(topics.ESTIMATE, topics.VEHICLE_STATE, topics.GATEWAY_STATUS)
        )
        writer = SessionWriter(path, session_metadata(given, "test", "wire", "now"), rotate_bytes=10**9)
        ours = given.car.codec.sent_by("computer")
        recorder = Recorder(given.recorder, loop.bus, loop.wire.link(), writer, UNIX_NS, sent=ours)
        events = EventLog(loop.bus)
        self.errors: list[tuple[float, float]] = []
        self.speed = 0.0
        while loop.elapsed_s < 60.0 and not (loop.result.failsafes and loop.plant.car.standing):
            loop.step()
            events.step(loop.clock.now_ns(), loop.gateway)
            recorder.step(loop.clock.now_ns())
            self._judge()
        recorder.close(loop.clock.now_ns())
        self.result = loop.finish()

    def _judge(self) -> None:
        car, newest = self.loop.plant.car, self.loop.result.messages[topics.ESTIMATE.key]
        estimate = newest[-1] if newest else None
        if isinstance(estimate, Estimate) and estimate.valid and car["vx"] > 10.0 and not car.uncorrected:
            off = math.hypot(estimate.x - car["x"], estimate.y - car["y"])
            self.errors.append((off, abs(math.remainder(estimate.yaw - car["yaw"], math.tau))))
            self.speed = max(self.speed, car["vx"])


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("receivers") / "s.mcap"


@pytest.fixture(scope="module")
def drive(session: Path) -> Drive:
    return Drive(session)


def test_positions_that_are_80_ms_late_place_the_car_within_centimetres(drive: Drive) -> None:
    off, turned = (sorted(errors) for errors in zip(*drive.errors, strict=True))
    assert drive.speed > 35.0  # 80 ms are 3 m
    assert len(off) > 400
    assert off[-1] < 0.15
    assert turned[-1] < 0.01
    state = drive.result.messages[topics.VEHICLE_STATE.key][-1]
    assert isinstance(state, VehicleState)
    assert state.receiver == "novatel_top"
    assert not state.sources["position"].valid


def test_lost_corrections_stop_the_car_on_the_road_and_say_so(drive: Drive, session: Path) -> None:
    (failsafe,) = drive.result.failsafes
    assert failsafe[1:] == ("controlled_stop", "position_lost")
    assert drive.result.off_track == 0
    assert drive.result.worst_margin_m > 0.3
    status = drive.result.messages[topics.GATEWAY_STATUS.key][-1]
    assert isinstance(status, GatewayStatus)
    assert status.detail == "novatel_top: no RTK (type 16)"
    recorded = [item.data.decode() for item in SessionReader(session, frozenset({topics.EVENT.key})).items()]
    assert any("no position fixes (novatel_top: no RTK (type 16))" in event for event in recorded)
    assert any('"receiver"' in event and "places the car" in event for event in recorded)


def test_a_bridge_is_passed_by_the_velocity_of_the_inertial_solution() -> None:
    """Corrections are away for 0.6 s, and ambiguities float for 4 s more: no fix for the first bend of the oval."""
    car = SimulatedCar(events=(RtkEvent(kind="rtk", t=LOST_S, for_s=0.6),))
    loop, errors = Loop(config(), simulated=car, keep=(topics.ESTIMATE, topics.VEHICLE_STATE)), list[float]()
    while loop.elapsed_s < 30.0 and not loop.result.failsafes:
        loop.step()
        newest, car = loop.result.messages[topics.ESTIMATE.key], loop.plant.car
        if newest and isinstance(estimate := newest[-1], Estimate) and estimate.valid and car["vx"] > 10.0:
            errors.append(math.hypot(estimate.x - car["x"], estimate.y - car["y"]))
    assert loop.finish().failsafes == []
    assert loop.result.worst_margin_m > 0.3
    assert max(errors) < 0.3
    assert errors[-1] < 0.15


def test_recording_holds_what_the_receivers_said_and_replays_byte_for_byte(drive: Drive, session: Path) -> None:
    given = required_config(session)
    assert given == config()
    comparison = compare(session, replay_estimator(session, given))
    assert all(comparison[topic.key].identical == comparison[topic.key].recorded > 0 for topic in OUTPUTS)
    said = list(SessionReader(session, frozenset({topics.NAVIGATION.key})).items())
    messages = [topics.NAVIGATION.message.model_validate_json(item.data) for item in said]
    assert len(messages) > 200 * 9.0
    assert {m.log for m in messages} == {"BESTPOS", "BESTVEL", "INSPVAX", "CORRIMUS"}
