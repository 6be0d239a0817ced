"""CAN logs of any program: the same frames out of every dialect, and clocks that are wrong said so."""

from __future__ import annotations

import bz2
import gzip
import json
import sqlite3
import struct
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import can
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from typer.testing import CliRunner

from can_dbc.codec import load_codec
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.can_link.cdr import CAN_SCHEMA, pack_frame
from hil_gateway.car.car import load_car
from hil_gateway.cli.main import app
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.importer import import_log
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.logs.reading import open_log
from hil_gateway.session.logs.wall_clock import parse_date
from hil_gateway.session.overview.info import session_info

DATE = 1_794_236_773 * NS_PER_S + 191_000_000
"""2026-11-09 15:06:13.191 UTC"""
NAMES = {message.name: number for number, message in load_codec().by_id.items()}
FRAMES = [
    Frame((0x514, 0x070, 0x57A, 0x516, EXTENDED_ID | 0x18FF0102)[i % 5], bytes([i, 255 - i, 7]), i * 1_000_000)
    for i in range(40)
]
"""stamps since the start"""


def number(frame: Frame, digits: int = 3) -> str:
    return f"{frame.id & ~EXTENDED_ID:08X}" if frame.id & EXTENDED_ID else f"{frame.id:0{digits}X}"


def seconds(ns: int, digits: int = 6) -> str:
    return f"{ns // NS_PER_S}.{ns % NS_PER_S // 10 ** (9 - digits):0{digits}d}"


def spaced(frame: Frame) -> str:
    return frame.data.hex(" ").upper()


def candump() -> str:
    return "".join(f"({seconds(DATE + f.stamp_ns)}) can0 {number(f)}#{f.data.hex()}\n" for f in FRAMES)


def printed(stamp: Callable[[Frame], str]) -> str:
    return "".join(f" ({stamp(f)})  can0  {number(f)}   [{len(f.data)}]  {spaced(f)}\n" for f in FRAMES)


def differences() -> str:
    before = [0, *(f.stamp_ns for f in FRAMES)]
    # every other one comes sooner: times since the frame before go up and down
    steps = {id(f): f.stamp_ns - b for f, b in zip(FRAMES, before, strict=False)}
    slip = {id(f): (300 if i % 2 else -300) * (i > 0) for i, f in enumerate(FRAMES)}
    return printed(lambda f: f"000.{steps[id(f)] // 1000 + slip[id(f)]:06d}")


def asc(date: str, base: str = "hex", stamps: str = "absolute", *, names: bool = False) -> str:
    head = f"date {date}\nbase {base}  timestamps {stamps}\ninternal events logged\n"
    text, before = head + "   0.000000 Start of measurement\n", 0
    for f in FRAMES:
        at, before = (f.stamp_ns - before if stamps == "relative" else f.stamp_ns), f.stamp_ns
        value = f.id & ~EXTENDED_ID
        name = "wheel_speed_report" if names and f.id == 0x514 else f"{value}" if base == "dec" else f"{value:X}"
        data = " ".join(str(b) for b in f.data) if base == "dec" else spaced(f)
        text += f"   {seconds(at)} 1  {name}{'x' * (value != f.id)}   Rx   d {len(f.data)} {data}  Length = 0\n"
        text += f"   {seconds(0 if stamps == 'relative' else f.stamp_ns)} 1  Statistic: D 10 R 0 XD 0 XR 0 E 0\n"
    return text


def busmaster() -> str:
    text = "date Mon Nov 9 03:06:13 pm 2026\nbase hex  no internal events logged\n// version 7.1.0\n"
    midnight = DATE // (86_400 * NS_PER_S) * 86_400 * NS_PER_S
    for f in FRAMES:
        extended = "x" * bool(f.id & EXTENDED_ID)
        stamp = seconds(DATE + f.stamp_ns - midnight)
        text += f"{stamp} 1 {f.id & ~EXTENDED_ID:X}{extended} Rx d {len(f.data)} {spaced(f)}\n"
    return text


def trc(version: str) -> str:
    start = DATE / NS_PER_S / 86_400 + 25_569
    head = f";$FILEVERSION={version}\n;$STARTTIME={start:.11f}\n"
    layouts = {
        "1.1": "{n}) {ms} Rx {id} {dlc} {data}", "1.2": "{n}) {ms} 1 Rx {id} {dlc} {data}",
        "1.3": "{n}) {ms} 1 Rx {id} - {dlc} {data}", "2.0": "{n} {ms} DT {id} Rx {dlc} {data}",
        "2.1": "{n} {ms} DT 1 {id} Rx - {dlc} {data}",
    }  # fmt: skip
    head += {"2.0": ";$COLUMNS=N,O,T,I,d,l,D\n", "2.1": ";$COLUMNS=N,O,T,B,I,d,R,L,D\n"}.get(version, "")
    lines = [
        layouts[version].format(n=i, ms=f"{f.stamp_ns / 1e6:.3f}", id=number(f, 4), dlc=len(f.data), data=spaced(f))
        for i, f in enumerate(FRAMES, start=1)
    ]
    return head + ";---\n" + "\n".join(lines) + "\n"


def gvret(*, direction: bool = True) -> str:
    text = f"Time Stamp,ID,Extended,{'Dir,' * direction}Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    for f in FRAMES:
        flag, data = str(bool(f.id & EXTENDED_ID)).lower(), ",".join(f"{b:02X}" for b in f.data)
        head = f"{f.stamp_ns // 1000},{f.id & ~EXTENDED_ID:08X},{flag},{'Rx,' * direction}"
        text += f"{head}0,{len(f.data)},{data},\n"
    return text


DIALECTS: dict[str, tuple[bytes, int]] = {
    "candump -l": (candump().encode(), DATE),
    "candump -t a": (printed(lambda f: seconds(DATE + f.stamp_ns)).encode(), DATE),
    "candump -t A": (printed(lambda f: f"2026-11-09 15:06:13.{191 + f.stamp_ns // 1_000_000:03d}000").encode(), DATE),
    "candump.gz": (gzip.compress(candump().encode()), DATE),
    "candump.bz2": (bz2.compress(candump().encode()), DATE),
    "candump.zst": (zstandard.compress(candump().encode()), DATE),
    "ASC": (asc("Mon Nov 9 03:06:13.191 pm 2026").encode(), DATE),
    "ASC with pm behind 24 h": (asc("Mon Nov 9 15:06:13.191 pm 2026").encode(), DATE),
    "ASC in French": (asc("lun. 9 nov. 15:06:13.191 2026").encode(), DATE),
    "ASC in German, cp1252": (asc("Mon Mär 9 15:06:13.191 2026").encode("cp1252"), DATE - 245 * 86_400 * NS_PER_S),
    "ASC in figures, UTF-16": (asc("Mo 09.11.2026 15:06:13.191").encode("utf-16"), DATE),
    "ASC in decimals": (asc("Mon Nov 9 03:06:13.191 pm 2026", base="dec").encode(), DATE),
    "ASC since the line before": (asc("Mon Nov 9 03:06:13.191 pm 2026", stamps="relative").encode(), DATE),
    "ASC by name": (asc("Mon Nov 9 03:06:13.191 pm 2026", names=True).encode(), DATE),
    "ASC of BUSMASTER": (busmaster().encode(), DATE),
    **{f"TRC {version}": (trc(version).encode(), DATE) for version in ("1.1", "1.2", "1.3", "2.0", "2.1")},
    "GVRET": (gvret().encode(), 0),
    "GVRET without direction": (gvret(direction=False).encode(), 0),
}  # fmt: skip


def read(path: Path) -> list[Frame]:
    return [entry.frame for entry in open_log(path, NAMES).frames()]


def content(frames: list[Frame]) -> list[tuple[int, bytes]]:
    return [(frame.id, frame.data) for frame in frames]


def test_frames_before_the_trigger_are_read(tmp_path: Path) -> None:
    """Their times are below zero."""
    lines = [f"{time}  1  123  Rx  d 1 {n:02X}" for n, time in enumerate(("-0.500000", "-0.250000", "0.250000"))]
    (tmp_path / "a.asc").write_text("\n".join(["date 9.11.2026 15:06:13", "base hex  timestamps absolute", *lines]))
    frames = [entry.frame for entry in open_log(tmp_path / "a.asc").frames()]
    assert [frame.data for frame in frames] == [b"\0", b"\1", b"\2"]
    assert [b.stamp_ns - a.stamp_ns for a, b in pairwise(frames)] == [250_000_000, 500_000_000]


def test_python_cans_own_asc_begins_at_its_first_frame(tmp_path: Path) -> None:
    """Its milliseconds of a date have no leading zeros: 10 ms are no 100 ms."""
    start_s = DATE // NS_PER_S + 0.01
    with can.ASCWriter(tmp_path / "a.asc") as writer:
        for i in range(3):
            writer.on_message_received(can.Message(timestamp=start_s + 0.1 * i, arbitration_id=0x514, data=b"\1"))
    stamps = [entry.frame.stamp_ns for entry in open_log(tmp_path / "a.asc").frames()]
    assert [stamp - DATE // NS_PER_S * NS_PER_S for stamp in stamps] == [10_000_000, 110_000_000, 210_000_000]


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_frames_at_the_same_times(tmp_path: Path, dialect: str) -> None:
    data, start_ns = DIALECTS[dialect]
    path = tmp_path / "a log of any name"
    path.write_bytes(data)
    frames = read(path)
    assert content(frames) == content(FRAMES)
    assert all(abs(f.stamp_ns - start_ns - g.stamp_ns) < 2_000 for f, g in zip(frames, FRAMES, strict=True))


def test_times_since_the_frame_before_are_added_up_and_that_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(differences())
    log = open_log(tmp_path / "a.log")
    stamps = [entry.frame.stamp_ns for entry in log.frames()]
    assert stamps == sorted(stamps)
    assert stamps[-1] == pytest.approx(FRAMES[-1].stamp_ns, abs=400_000)
    assert "times are differences to the frame before" in log.notes[0]


@pytest.mark.parametrize("zone", ["UTC", "America/New_York", "Asia/Tokyo"])
def test_where_a_log_is_read_does_not_change_its_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, zone: str
) -> None:
    import can

    with can.BLFWriter(tmp_path / "a.blf") as writer:
        for f in FRAMES:
            writer(can.Message(arbitration_id=f.id & ~EXTENDED_ID, data=f.data, timestamp=(DATE + f.stamp_ns) / 1e9))
    (tmp_path / "a.asc").write_bytes(DIALECTS["ASC"][0])
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        blf, text = read(tmp_path / "a.blf"), read(tmp_path / "a.asc")
    finally:
        monkeypatch.undo()
        time.tzset()
    assert [f.stamp_ns // 1000 for f in blf] == [f.stamp_ns // 1000 for f in text]
    assert abs(blf[0].stamp_ns - DATE) < 2_000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("mar. 10 nov. 2026 9:06:13", "2026-11-10 09:06:13"),
        ("Di Mai 5 15:06:13 2026", "2026-05-05 15:06:13"),
        ("mer. juil. 1 12:00:01 am 2026", "2026-07-01 00:00:01"),
        ("sam. déc. 5 9:06:13 2026", "2026-12-05 09:06:13"),
        ("11/9/2026 3:06:13 PM", "2026-11-09 15:06:13"),
        ("zo mrt 1 09:00:00 2026", "2026-03-01 09:00:00"),
    ],
)
def test_dates_are_read_in_the_language_they_are_in(text: str, expected: str) -> None:
    stamp = parse_date(text)
    assert stamp is not None
    assert time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(stamp // NS_PER_S)) == expected


def steady(count: int = 400) -> list[tuple[int, str]]:
    return [(DATE + i * 1_000_000, f"can0 123#{i % 256:02X}") for i in range(count)]


def written(path: Path, lines: list[tuple[int, str]]) -> Path:
    path.write_text("".join(f"({seconds(stamp)}) {line}\n" for stamp, line in lines))
    return path


def test_a_frame_stamped_far_ahead_moves_nothing_else(tmp_path: Path) -> None:
    lines = steady()
    lines[100] = (lines[100][0] + 6 * NS_PER_S, lines[100][1])
    log = open_log(written(tmp_path / "a.log", lines))
    stamps = [entry.frame.stamp_ns for entry in log.frames()]
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] == 399_000_000
    assert "1 frames are stamped up to 6 s off" in log.notes[0]


def test_a_clock_that_is_set_back_never_mixes_what_was_logged(tmp_path: Path) -> None:
    lines = steady()
    lines = lines[:200] + [(stamp - 3600 * NS_PER_S, line) for stamp, line in lines[200:]]
    log = open_log(written(tmp_path / "a.log", lines))
    frames = [entry.frame for entry in log.frames()]
    assert [f.data[0] for f in sorted(frames, key=lambda f: f.stamp_ns)] == [i % 256 for i in range(400)]
    assert frames[-1].stamp_ns - frames[0].stamp_ns == pytest.approx(399_000_000, abs=2_000_000)
    assert "the clock was set back once, by up to 3600" in log.notes[0]


def test_a_pause_of_a_log_is_none_of_its_faults(tmp_path: Path) -> None:
    lines = steady()
    lines = lines[:200] + [(stamp + 60 * NS_PER_S, line) for stamp, line in lines[200:]]
    log = open_log(written(tmp_path / "a.log", lines))
    stamps = [entry.frame.stamp_ns for entry in log.frames()]
    assert stamps == [stamp for stamp, _ in lines]
    assert log.notes == []


def test_a_frame_logged_twice_counts_once(tmp_path: Path) -> None:
    lines = [line for line in steady(50) for _ in range(2)]
    log = open_log(written(tmp_path / "a.log", lines))
    assert len(list(log.frames())) == 50
    assert log.left_out == {"frame that was logged twice": 50}


def test_the_monitor_keeps_buses_apart_and_says_what_is_wrong(tmp_path: Path) -> None:
    lines = [
        (stamp + bus * 100_000, f"can{bus} {message}{(i + 7 * bus) % 256:02X}")
        for i, (stamp, _) in enumerate(steady(200)) for bus in (0, 1) for message in ("515#00000000", "516#0000")
    ]  # fmt: skip
    lines.append((lines[-1][0] + 1000, "can0 20000004#0000000000000000"))
    lines.append((lines[-1][0] + 1000, "can0 123##311223344"))
    path = written(tmp_path / "a.log", lines)
    told = json.loads(CliRunner().invoke(app, ["can", "monitor", str(path), "--json"]).stdout)
    assert told["buses"] == {
        "can0": {"frames": 401, "error_frames": 1}, "can1": {"frames": 400, "error_frames": 0}
    }  # fmt: skip
    assert [m["bus"] for m in told["messages"]] == ["can0", "can0", "can1", "can1"]
    assert not any(m["counter_errors"] or m["late"] for m in told["messages"])
    assert told["left_out"] == {"CAN FD or CAN XL frame": 1}
    assert any("times as often as the DBC declares" in note for note in told["notes"])
    one = json.loads(CliRunner().invoke(app, ["can", "monitor", str(path), "--json", "--channel", "can1"]).stdout)
    assert one["frames"] == 400


def mcap_bag(
    path: Path, topic: str, *, chunked: bool = True, compression: CompressionType = CompressionType.ZSTD
) -> None:
    with path.open("wb") as out:
        writer = Writer(out, use_chunking=chunked, compression=compression)
        writer.start(profile="ros2", library="libmcap")
        schema = writer.register_schema("can_msgs/msg/Frame", "ros2msg", CAN_SCHEMA.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for i, f in enumerate(FRAMES):
            writer.add_message(channel, DATE + f.stamp_ns, pack_frame(f, DATE + f.stamp_ns, "can"), 0, i)
        writer.finish()


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize(
    ("topic", "bus"), [("/from_can_bus", "can"), ("/rear/can_rx", "rear"), ("/own/topic", "own/topic")]
)
def test_a_bag_is_read_whatever_its_topic_and_layout(tmp_path: Path, topic: str, bus: str, chunked: bool) -> None:
    mcap_bag(tmp_path / "a.mcap", topic, chunked=chunked)
    entries = list(open_log(tmp_path / "a.mcap").frames())
    assert content([e.frame for e in entries]) == content(FRAMES)
    assert {e.channel for e in entries} == {bus}
    told = session_info(tmp_path / "a.mcap", car=load_car())
    assert (told["messages"], told["complete"], told["damage"]) == (len(FRAMES), True, [])
    assert import_log(tmp_path / "a.mcap", tmp_path / "s.mcap", load_car()).frames == len(FRAMES)


@pytest.mark.parametrize("chunked", [True, False])
def test_a_bag_that_was_cut_off_gives_what_is_there(tmp_path: Path, chunked: bool) -> None:
    mcap_bag(tmp_path / "a.mcap", "/can", chunked=chunked, compression=CompressionType.NONE)
    whole = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(whole[: len(whole) - 2500])
    log = open_log(tmp_path / "a.mcap")
    count = len(list(log.frames()))
    assert (0 < count <= len(FRAMES)) if not chunked else count in (0, len(FRAMES))
    assert log.notes


def test_a_remote_request_in_a_bag_is_no_data(tmp_path: Path) -> None:
    remote = bytearray(pack_frame(Frame(0x123, b"", 0), DATE, "can"))
    remote[remote.index(struct.pack("<I", 0x123)) + 4] = 1
    with (tmp_path / "a.mcap").open("wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2", library="libmcap")
        schema = writer.register_schema("can_msgs/msg/Frame", "ros2msg", CAN_SCHEMA.encode())
        writer.add_message(writer.register_channel("/can", "cdr", schema), DATE, bytes(remote), DATE)
        writer.finish()
    log = open_log(tmp_path / "a.mcap")
    assert list(log.frames()) == []
    assert log.left_out == {"remote request": 1}


def sqlite_bag(path: Path, frames: list[Frame], *, packed: bool = False) -> None:
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
    database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    database.execute("INSERT INTO topics VALUES (1, '/from_can_bus', 'can_msgs/msg/Frame', 'cdr')")
    for f in frames:
        data = pack_frame(f, DATE + f.stamp_ns, "can")
        row = (DATE + f.stamp_ns, zstandard.compress(data) if packed else data)
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", row)
    database.commit()
    database.close()


@pytest.mark.parametrize("packed", [True, False])
def test_a_folder_of_parts_is_one_bag(tmp_path: Path, packed: bool) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    for part in range(11):  # part 10 comes after part 9, not after part 1
        sqlite_bag(folder / f"bag_{part}.db3", FRAMES[part::11][:3], packed=packed)
    expected = [f for part in range(11) for f in FRAMES[part::11][:3]]
    assert content([e.frame for e in open_log(folder).frames()]) == content(expected)
    told = session_info(folder, car=load_car())
    assert told["topics"]["/from_can_bus"]["messages"] == len(expected)


def test_a_bag_that_is_compressed_as_a_whole_is_read(tmp_path: Path) -> None:
    sqlite_bag(tmp_path / "a.db3", FRAMES)
    (tmp_path / "b.db3.zstd").write_bytes(zstandard.compress((tmp_path / "a.db3").read_bytes()))
    assert content(read(tmp_path / "b.db3.zstd")) == content(FRAMES)


def test_a_chunk_of_two_frames_of_the_compressor_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    once = zstandard.compress

    def twice(data: bytes, *_: object) -> bytes:
        return once(data[: len(data) // 2]) + once(data[len(data) // 2 :])

    monkeypatch.setattr("mcap.writer.zstandard.compress", twice, raising=False)
    mcap_bag(tmp_path / "a.mcap", "/can")
    reader = SessionReader(tmp_path / "a.mcap")
    assert len(list(reader.items())) == len(FRAMES)
    assert reader.damage == []


def cut(data: bytes) -> Iterator[bytes]:
    yield from (data[: len(data) // 2], data[: len(data) - 20])


def test_a_packed_log_that_was_cut_off_says_so(tmp_path: Path) -> None:
    for part in cut(gzip.compress(candump().encode() * 500)):
        (tmp_path / "a.log.gz").write_bytes(part)
        log = open_log(tmp_path / "a.log.gz")
        assert len(list(log.frames())) > 100
        assert log.left_out["end that was cut off"] >= 1


def test_a_short_packed_log_that_was_cut_off_gives_what_is_there(tmp_path: Path) -> None:
    """Shorter than what its kind is recognised by: what is whole of it is not lost with its end."""
    text = "".join(f"(1700000000.{n:06d}) slcan3 123#{(n * 2654435761) % 2**64:016X}\n" for n in range(800))
    (tmp_path / "a.log.gz").write_bytes((packed := gzip.compress(text.encode()))[: len(packed) * 7 // 10])
    log = open_log(tmp_path / "a.log.gz")
    assert 400 < len(list(log.frames())) < 800
    assert log.left_out["end that was cut off"] == 1


def test_what_is_printed_without_times_is_refused_for_that(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("  can0  123   [2]  11 22\n")
    with pytest.raises(InputError, match="no time: candump prints it with -t a"):
        read(tmp_path / "a.log")


PUBLIC = {
    "c01_hop.log": 3029, "c03_delta.log": 3029, "c05_busmaster.asc": 2500, "c07_24h_pm.asc": 400,
    "c07b_french.asc": 400, "c07c_german_cp1252.asc": 400, "c10_two_buses.log": 3040, "c12_pcan.trc": 1500,
    "c13_gvret.csv": 1500, "c16_rotated.log.gz": 1500, "c18_symbolic.asc": 800, "m01_rosbag_from_can_bus.mcap": 2000,
    "m02_own_topic_nochunk.mcap": 1500, "m08_own_ros2_export.mcap": 3478,
}  # fmt: skip
"""file -> frames in it"""


@pytest.mark.parametrize("name", PUBLIC)
def test_logs_of_other_programs_are_read_whole(measured_data: Path, name: str) -> None:
    frames = read(measured_data / "public" / name)
    stamps = [f.stamp_ns for f in frames]
    assert len(frames) == PUBLIC[name]
    assert min(b - a for a, b in pairwise(stamps)) >= 0
    assert 0.3 < (stamps[-1] - stamps[0]) / NS_PER_S < 3.0
