"""The DBC reader agrees with cantools, and refuses what it does not know."""

from __future__ import annotations

import doctest
import subprocess
import sys
from pathlib import Path

import cantools
import pytest

from can_dbc.database import DBC_PATH, DatabaseError, load_database, parse_database

DBC = DBC_PATH.read_text()
TOML = DBC_PATH.with_suffix(".toml").read_text()
PEER = cantools.database.load_file(DBC_PATH, strict=True)


def test_every_message_is_read_as_cantools_reads_it() -> None:
    ours = {
        (m.name, m.id, m.dlc, m.sender, s.name, s.start, s.length, s.little_endian, s.signed, s.scale, s.offset, s.unit)
        for m in load_database().messages
        for s in m.signals
    }
    theirs = {
        (m.name, m.frame_id, m.length, m.senders[0], s.name, s.start, s.length, s.byte_order == "little_endian",
         s.is_signed, s.scale, s.offset, s.unit or "")
        for m in PEER.messages
        for s in m.signals
    }  # fmt: skip
    assert ours == theirs
    assert len(load_database().messages) == 53 + 3


def test_declared_ranges_agree_with_cantools() -> None:
    for message in load_database().messages:
        for signal in message.signals:
            peer = PEER.get_message_by_name(message.name).get_signal_by_name(signal.name)
            assert signal.declared == (None if peer.minimum is None else (peer.minimum, peer.maximum))


def test_every_limit_lies_within_what_its_field_can_carry() -> None:
    for message in load_database().messages:
        for signal in message.signals:
            if signal.limits:
                raw = sorted((limit - signal.offset) / signal.scale for limit in signal.limits)
                assert signal.raw_range[0] <= raw[0] < raw[1] <= signal.raw_range[1], signal.name


def test_every_counter_fits_its_modulus() -> None:
    counters = [(m, m.counter) for m in load_database().messages if m.counter]
    assert len(counters) == 8
    for message, counter in counters:
        assert counter.modulus - 1 <= message.signal[counter.signal].raw_range[1]


def test_directions_are_those_of_the_car() -> None:
    sent_by_us = {message.id for message in load_database().messages if message.direction == "computer"}
    assert sent_by_us == {0x578, 0x579, 0x57A, 0x57B, 0x57C, 0x57D, 0x57E, 0x5AA}


@pytest.mark.parametrize(
    ("dbc", "toml", "complaint"),
    [
        (DBC.replace("AV-24 CAN1 2024", "AV-21"), TOML, "AV-21"),
        (DBC.replace('VERSION "', 'V "'), TOML, "no VERSION"),
        (DBC, TOML.replace("novatel_report = 0.25", "novatel_reprot = 0.25"), "novatel_reprot"),
        (DBC, TOML.replace("current_gear = ", "curent_gear = "), "curent_gear"),
        (DBC, TOML.replace('"raptor_rolling_counter"', '"raptor_counter"'), "misc_report"),
        (DBC.replace('"kmph"', '"furlong"'), TOML, "furlong"),
        (DBC.replace("SG_ desired_gear : 0|8@1+", "SG_ desired_gear m0 : 0|8@1+"), TOML, "desired_gear m0"),
        (DBC.replace("BO_ 1403 gear_shift_cmd: 8", "BO_ 1403 gear_shift_cmd 8"), TOML, "gear_shift_cmd 8"),
        (DBC.replace("SG_ engine_state : 6|1@0+", "SG_ engine_state : 6|1@1+"), TOML, "pt_report_1"),
        (DBC.replace("SG_ desired_gear : 0|8@1+", "SG_ desired_gear : 60|8@1+"), TOML, "desired_gear does not fit"),
        (DBC.replace("SG_ desired_gear : 0|8@1+", "SG_ desired_gear : 0|0@1+"), TOML, "desired_gear does not fit"),
        (DBC.replace("SG_ desired_gear : 0|8@1+ (1,", "SG_ desired_gear : 0|8@1+ (0,"), TOML, "scale 0"),
        (DBC.replace("SG_ wheel_speed_FR : 16|", "SG_ wheel_speed_FR : 8|"), TOML, "wheel_speed_FR overlaps"),
        (DBC.replace("BO_ 1403 gear_shift_cmd: 8", "BO_ 1402 gear_shift_cmd: 8"), TOML, "two of one identifier"),
    ],
)
def test_a_database_that_does_not_fit_is_refused_by_name(dbc: str, toml: str, complaint: str) -> None:
    with pytest.raises(DatabaseError, match=complaint):
        parse_database(dbc, toml)


@pytest.mark.parametrize("content", [None, b"", b"\xff\x00", DBC.encode()[: len(DBC) // 2]])
def test_a_damaged_file_is_one_clear_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "av24.dbc"
    if content is not None:
        path.write_bytes(content)
        path.with_suffix(".toml").write_text(TOML)
    code = (
        "import sys, pathlib, can_dbc.database as d; d.DBC_PATH = pathlib.Path(sys.argv.pop(1));"
        "from hil_gateway.cli.main import main; main()"
    )
    command = [sys.executable, "-c", code, str(path), "gateway", "run"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith(f"hil: {path}")


def test_the_examples_of_the_readme_are_right() -> None:
    result = doctest.testfile(str(DBC_PATH.with_name("README.md")), module_relative=False)
    assert (result.failed, result.attempted > 4) == (0, True)
