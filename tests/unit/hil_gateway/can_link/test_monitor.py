"""The bus in the terminal: signals as an independent decoder reads them, rates, ages, counters, changes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cantools
import pytest
from support.cars.scripted_car import Rig
from support.cars.session_rig import UNIX_NS
from typer.testing import CliRunner

from can_dbc.codec import load_codec
from can_dbc.folder import SHIPPED
from hil_gateway.can_link import Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.can_link.monitor import FrameMonitor, line, signals
from hil_gateway.cli.main import app
from hil_gateway.session.exchange.signals import export_signals
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.session.logs.candump import format_line

STEERING = 0x517


def drive(seconds: float = 2.0) -> list[Frame]:
    """What is on the bus while the scripted car drives off."""
    rig = Rig()
    listener = rig.wire.link()
    heard: list[Frame] = []
    rig.hooks.append(lambda rig: heard.extend(listener.receive(0.0)))
    rig.drive_off(seconds)
    return heard


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return drive()


def watched(frames: list[Frame], *filters: str) -> FrameMonitor:
    view = FrameMonitor(load_codec(), filters)
    view.take(frames)
    return view


def test_every_signal_is_what_cantools_reads(frames):
    database = cantools.database.load_file(SHIPPED / "av24/av24.dbc")
    streams = watched(frames).shown()
    assert len(streams) >= 15
    for stream in streams:
        expected = database.decode_message(stream.frame_id, stream.data, decode_choices=False)
        assert stream.values == pytest.approx(expected)


def test_rates_are_those_of_the_bus_and_a_message_that_stays_away_is_late(frames):
    stream = watched(frames).streams[STEERING]
    assert stream.rate_hz == pytest.approx(100.0, rel=0.01)
    assert not stream.late(stream.last_ns + 10_000_000)
    assert stream.late(stream.last_ns + 2 * 10**9)
    assert " LATE" in line(stream, stream.last_ns + 2 * 10**9)


def test_a_frame_left_out_is_one_wrong_counter(frames):
    numbers = [i for i, frame in enumerate(frames) if frame.id == STEERING]
    assert watched(frames).streams[STEERING].counter_errors == 0
    without = frames[: numbers[50]] + frames[numbers[50] + 1 :]
    assert watched(without).streams[STEERING].counter_errors == 1


def test_what_changes_stands_out_for_a_second_and_a_counter_never_does(frames):
    view = watched(frames)
    stream = view.streams[STEERING]
    stream.values["commanded_steering_rate"] = -1.0
    stream.take(Frame(STEERING, stream.data, stream.last_ns + 10_000_000, False), load_codec())
    now = {text.split("=")[0]: changed for text, changed in signals(stream, stream.last_ns)}
    later = {text.split("=")[0]: changed for text, changed in signals(stream, stream.last_ns + 2 * 10**9)}
    assert now["commanded_steering_rate"] and not any(later.values())
    assert not now["steering_motor_fdbk_counter"]


def test_filters_pick_by_id_message_or_signal(frames):
    assert [s.frame_id for s in watched(frames, "0x517").shown()] == [STEERING]
    assert {s.name for s in watched(frames, "wheel_speed_fl").shown()} == {"wheel_speed_report"}
    assert watched(frames, "no such thing").shown() == []


def test_unknown_and_short_frames_show_their_bytes_or_the_fault():
    view = watched([Frame(0x7AB, b"\x01\x02", 1, False), Frame(STEERING, b"\x00", 2, False)])
    assert "01 02" in line(view.streams[0x7AB], 2)
    assert "1 bytes, the DBC says" in line(view.streams[STEERING], 2)


def test_a_log_is_shown_without_a_bus(frames, tmp_path: Path):
    log = tmp_path / "x.log"
    log.write_text("".join(f"{format_line(Frame(f.id, f.data, f.stamp_ns + UNIX_NS), 'can0')}\n" for f in frames))
    run = CliRunner()
    said = run.invoke(app, ["can", "monitor", str(log), "--filter", "wheel_speed_report"])
    assert "0x514 wheel_speed_report 100.0 Hz" in said.output
    tree = json.loads(run.invoke(app, ["can", "monitor", str(log), "--json"]).stdout)
    assert tree["frames"] == len(frames)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_exported_signals_hold_the_value_of_the_newest_frame(frames, tmp_path: Path, suffix):
    session, target = tmp_path / "s.mcap", tmp_path / f"out{suffix}"
    with SessionFile(session, {}) as file:
        for number, frame in enumerate(frames):
            stamp = frame.stamp_ns + UNIX_NS
            file.add(CAN_TOPIC, pack_frame(frame, stamp), stamp, stamp, number)
    done = export_signals(session, target)
    if suffix == ".csv":
        rows = list(csv.DictReader(target.read_text().splitlines()))
        last = {name: float(value) for name, value in rows[-1].items()}
    else:
        import pyarrow.parquet as pq

        table = pq.read_table(target)
        rows, last = table.to_pylist(), table.to_pylist()[-1]
    assert len(rows) == done.rows > 250
    for stream in watched(frames).shown():
        for signal in stream.message.signals if stream.message else ():
            unit = f" [{signal.unit}]" if signal.unit else ""
            assert last[f"{stream.name}.{signal.name}{unit}"] == pytest.approx(stream.values[signal.name]), signal.name
