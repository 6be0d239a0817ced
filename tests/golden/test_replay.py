"""R4: replaying a session gives byte-identical estimator outputs, twice, and against the recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.promise_figures import record_figure

from estimator.replay import OUTPUTS, compare, replay_estimator
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.session.files.configuration import required_config
from hil_gateway.session.files.format import session_metadata
from hil_gateway.session.files.writer import SessionWriter
from hil_gateway.session.recorder import Recorder
from planner.simulation.loop import Loop

UNIX_NS = 1_700_000_000 * 10**9
DRIVE_S = 6.0


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded drive of the whole loop."""
    path = tmp_path_factory.mktemp("session") / "s.mcap"
    config = Config()
    loop = Loop(config)
    writer = SessionWriter(path, session_metadata(config, "test", "wire", "now"), rotate_bytes=10**9)
    recorder = Recorder(
        config.recorder, loop.bus, loop.wire.link(), writer, UNIX_NS, sent=load_car().codec.sent_by("computer")
    )
    while not loop.result.armed or loop.finish().seconds < DRIVE_S:
        loop.step()
        recorder.step(loop.clock.now_ns())
    recorder.close(loop.clock.now_ns())
    return path


@pytest.mark.promise("R4")
def test_replayed_estimator_outputs_are_the_recorded_bytes(session: Path) -> None:
    config = required_config(session)
    assert config == Config()
    first, second = (replay_estimator(session, config) for _ in range(2))
    assert first == second
    comparison = compare(session, first)
    for topic in OUTPUTS:
        assert comparison[topic.key].identical == comparison[topic.key].recorded > DRIVE_S * topic.rate_hz
    total = sum(c.recorded for c in comparison.values())
    record_figure("R4", f"{total} outputs, twice and against the recording, all identical")
