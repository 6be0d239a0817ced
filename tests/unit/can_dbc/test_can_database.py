"""The DBC reader agrees with cantools, and refuses what it does not know."""

from __future__ import annotations

import doctest
import shutil
import subprocess
import sys
from pathlib import Path

import cantools
import pytest

from can_dbc.codec import load_codec
from can_dbc.errors import PlatformError
from can_dbc.folder import SHIPPED, platforms

FOLDER = SHIPPED / "av24"
PEER = cantools.database.load_file(FOLDER / "av24.dbc", strict=True)
MESSAGES = tuple(load_codec().messages.values())


def test_every_message_is_read_as_cantools_reads_it() -> None:
    ours = {
        (m.name, m.id, m.dlc, m.sender, s.name, s.start, s.length, s.little_endian, s.signed, s.scale, s.offset, s.unit)
        for m in MESSAGES
        for s in m.signals
    }
    theirs = {
        (m.name, m.frame_id, m.length, m.senders[0], s.name, s.start, s.length, s.byte_order == "little_endian",
         s.is_signed, s.scale, s.offset, s.unit or "")
        for m in PEER.messages
        for s in m.signals
    }  # fmt: skip
    assert ours == theirs
    assert len(MESSAGES) == 53 + 3


def test_declared_ranges_agree_with_cantools() -> None:
    for message in MESSAGES:
        for signal in message.signals:
            peer = PEER.get_message_by_name(message.name).get_signal_by_name(signal.name)
            assert signal.declared == (None if peer.minimum is None else (peer.minimum, peer.maximum))


def test_every_limit_lies_within_what_its_field_can_carry() -> None:
    for message in MESSAGES:
        for signal in message.signals:
            if signal.limits:
                raw = sorted((limit - signal.offset) / signal.scale for limit in signal.limits)
                assert signal.raw_range[0] <= raw[0] < raw[1] <= signal.raw_range[1], signal.name


def test_every_counter_fits_its_modulus() -> None:
    counters = [(m, m.counter) for m in MESSAGES if m.counter]
    assert len(counters) == 8
    for message, counter in counters:
        assert counter.modulus - 1 <= message.signal[counter.signal].raw_range[1]


def test_directions_are_those_of_the_car() -> None:
    sent_by_us = {message.id for message in MESSAGES if message.direction == "computer"}
    assert sent_by_us == {0x578, 0x579, 0x57A, 0x57B, 0x57C, 0x57D, 0x57E, 0x5AA}


def altered(tmp_path: Path, file: str, old: str, new: str) -> str:
    """The shipped car with one place of one file changed."""
    folder = tmp_path / "car"
    shutil.copytree(FOLDER, folder)
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    return str(folder)


@pytest.mark.parametrize(
    ("file", "old", "new", "complaint"),
    [
        ("av24.dbc", "AV-24 CAN1 2024", "AV-21", "VERSION 'AV-21' is not dbc_version"),
        ("av24.dbc", 'VERSION "', 'V "', "no VERSION"),
        ("av24.dbc", '"kmph"', '"furlong"', "unit 'furlong'.*units"),
        ("av24.dbc", "SG_ desired_gear : 0|8@1+", "SG_ desired_gear m0 : 0|8@1+", "desired_gear m0"),
        ("av24.dbc", "BO_ 1403 gear_shift_cmd: 8", "BO_ 1403 gear_shift_cmd 8", "gear_shift_cmd 8"),
        ("av24.dbc", "SG_ engine_state : 6|1@0+", "SG_ engine_state : 6|1@1+", "pt_report_1: .*two byte orders"),
        ("av24.dbc", "SG_ desired_gear : 0|8@1+", "SG_ desired_gear : 60|8@1+", "desired_gear does not fit"),
        ("av24.dbc", "SG_ desired_gear : 0|8@1+", "SG_ desired_gear : 0|0@1+", "desired_gear does not fit"),
        ("av24.dbc", "SG_ desired_gear : 0|8@1+ (1,", "SG_ desired_gear : 0|8@1+ (0,", "scale 0"),
        ("av24.dbc", "SG_ wheel_speed_FR : 16|", "SG_ wheel_speed_FR : 8|", "wheel_speed_FR overlaps"),
        ("av24.dbc", "BO_ 1403 gear_shift_cmd: 8", "BO_ 1402 gear_shift_cmd: 8", "identifier 0x57A"),
        ("av24.dbc", "BO_ 1403 gear_shift_cmd: 8", "BO_ 4403 gear_shift_cmd: 8", "4403 has more than 11 bits.*bit 31"),
        ("av24.dbc", "BO_ 1403 gear_shift_cmd: 8", "BO_ 1403 gear_shift_cmd: 64", "64 bytes.*1 to 8"),
        ("bus.toml", "novatel_report = 0.25", "novatel_reprot = 0.25", "deadline_s.*novatel_reprot"),
        ("bus.toml", "novatel_report = 0.25", "novatel_report = -1", "deadline_s.novatel_report = -1"),
        ("bus.toml", "current_gear = ", "curent_gear = ", "curent_gear; like it are current_gear"),
        ("bus.toml", '"raptor_rolling_counter"', '"raptor_counter"', "misc_report.*raptor_counter"),
        ("bus.toml", '"brk_pressure_cmd_counter", 256', '"brk_pressure_cmd_counter", 300', "cannot count to 299"),
        ("bus.toml", "bitrate = 1_000_000", "bitrate = 5", "bitrate = 5"),
        ("bus.toml", "bitrate", "bit_rate", "unknown key bit_rate|bitrate is missing"),
        ("bus.toml", "current_gear = [0.0, 6.0]", "current_gear = [6.0, 0.0]", "first must be below"),
        ("signals.toml", '"wheel_speed_FL"', '"wheel_sped_FL"', "report.wheel_speed_fl.*like it are wheel_speed_FL"),
        ("signals.toml", "wheel_speed_fl =", "wheel_speed_f1 =", "unknown quantity report.wheel_speed_f1; like it are"),
        ("signals.toml", 'gear = "current_gear"', "", "report.gear is missing"),
        ("signals.toml", 'gear = "current_gear"', 'gear = "engine_speed_rpm"', "rad/s.*1 is needed"),
        ("signals.toml", 'gear = "current_gear"', 'gear = { signal = "current_gear", factor = 0 }', "factor = 0"),
        ("signals.toml", 'gear = "current_gear"', 'gear = { signal = "current_gear", uint = "1" }', "report.gear.uint"),
        ("signals.toml", 'gear = "current_gear"', 'gear = "desired_gear"', "sent by the computer.*computer_sends"),
        ("signals.toml", 'gear = "desired_gear"', 'gear = "current_gear"', "sent by the car"),
        ("signals.toml", "driving = 9", "driving = 8", "sys_state: idle shares its code 8"),
        ("signals.toml", "driving = 9", "driving = 900", "sys_state cannot carry it"),
        ("signals.toml", "driving = 9", "drivin = 9", "unknown key codes.sys_state.drivin"),
        ("signals.toml", "driving = 9", "", "codes.sys_state.driving is missing"),
        ("signals.toml", "emergency = 12", "emergency = 10", "shares its code 10"),
        ("signals.toml", "failures = [", 'failures = ["gone",', "failures: gone: the DBC has no signal gone"),
    ],
)
def test_a_mistake_in_a_folder_is_named(tmp_path: Path, file: str, old: str, new: str, complaint: str) -> None:
    platform = altered(tmp_path, file, old, new)
    with pytest.raises(PlatformError, match=complaint) as caught:
        load_codec(platform)
    assert str(caught.value).startswith(f"{platform}/{file}: ")


@pytest.mark.parametrize("content", [None, b"", b"\xff\x00", (FOLDER / "av24.dbc").read_bytes()[:5000]])
def test_a_damaged_file_is_one_clear_line(tmp_path: Path, content: bytes | None) -> None:
    folder = tmp_path / "car"
    shutil.copytree(FOLDER, folder)
    path = folder / "av24.dbc"
    path.unlink() if content is None else path.write_bytes(content)
    code = f"from can_dbc.codec import load_codec; load_codec({str(folder)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert "PlatformError" in done.stderr.splitlines()[-1], done.stderr


def test_a_car_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(PlatformError, match=r"neither a folder nor one of .*av24"):
        load_codec("av42")
    assert "av24" in platforms()


def test_the_examples_of_the_readme_are_right() -> None:
    result = doctest.testfile(str(SHIPPED / "README.md"), module_relative=False)
    assert (result.failed, result.attempted > 4) == (0, True)
