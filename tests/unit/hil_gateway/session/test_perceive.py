"""A log of raw frames alone becomes a session with vehicle states and estimates; what was not in it is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cars.scripted_car import Rig
from support.cars.session_rig import UNIX_NS

from estimator.estimate_session import estimate_session
from hil_gateway.bus.topics import ESTIMATE, VEHICLE_STATE
from hil_gateway.can_link import Frame
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import read_drive_table
from hil_gateway.session.exchange.importer import import_log
from hil_gateway.session.exchange.perceive import perceive
from hil_gateway.session.files.format import unpack_message
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.logs.candump import format_line


def frames_of_a_drive(seconds: float) -> list[Frame]:
    """What another logger on the bus hears while the scripted car drives off, in Unix time."""
    rig = Rig()
    logger = rig.wire.link()
    heard: list[Frame] = []
    rig.hooks.append(lambda rig: heard.extend(logger.receive(0.0)))
    rig.drive_off(seconds)
    return [Frame(f.id, f.data, f.stamp_ns + UNIX_NS, f.is_error) for f in heard]


def log_of(frames: list[Frame], path: Path) -> Path:
    path.write_text("".join(f"{format_line(frame, 'can0')}\n" for frame in frames))
    return path


def test_a_candump_log_alone_becomes_a_session_with_states_and_estimates(tmp_path):
    raw, states, whole = (tmp_path / f"{name}.mcap" for name in ("raw", "states", "whole"))
    import_log(log_of(frames_of_a_drive(8.0), tmp_path / "x.log"), raw, load_car())
    seen = perceive(raw, states, Config())
    assert seen.valid > 0.9 * seen.states > 300 and seen.never_heard == set()
    speeds = [unpack_message(VEHICLE_STATE, item.data) for item in SessionReader(states).items()
              if item.topic == VEHICLE_STATE.key]  # fmt: skip
    assert len(speeds) == seen.states
    count = estimate_session(states, whole, Config())
    assert count[ESTIMATE.key] == seen.states
    table = read_drive_table(whole)
    assert count["valid"] >= len(table.columns["t"]) > 300
    assert table.start_ns > UNIX_NS


def test_reports_that_are_not_in_the_log_are_named(tmp_path):
    raw, states = tmp_path / "raw.mcap", tmp_path / "states.mcap"
    without_imu = [frame for frame in frames_of_a_drive(1.0) if frame.id not in (0x70, 0x80, 0x576)]
    import_log(log_of(without_imu, tmp_path / "x.log"), raw, load_car())
    seen = perceive(raw, states, Config())
    assert seen.never_heard == {"imu"} and seen.valid == 0


def test_a_session_without_frames_or_states_is_one_clear_line(tmp_path):
    raw, other = tmp_path / "raw.mcap", tmp_path / "other.mcap"
    import_log(log_of(frames_of_a_drive(0.1), tmp_path / "x.log"), raw, load_car())
    with pytest.raises(InputError, match="holds no av24/vehicle_state"):
        estimate_session(raw, other, Config())
    assert not other.exists()
