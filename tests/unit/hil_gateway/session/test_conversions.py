"""Sessions are recovered, exported and imported: a whole file or none, and nothing left out without a word."""

from __future__ import annotations

import os
import random
import re
import resource
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from support.cars.session_rig import recorded

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.car import load_car
from hil_gateway.cli.session import export, import_
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.export import export_candump
from hil_gateway.session.exchange.importer import import_log
from hil_gateway.session.files.format import CAN_TOPIC, unpack_frame
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.recover import recover
from hil_gateway.session.files.writer import SessionWriter

DATE = 1_700_000_000.25


def frames_of(path: Path) -> list[Frame]:
    return [unpack_frame(item.data) for item in SessionReader(path).items() if item.topic == CAN_TOPIC]


def test_recovered_file_is_complete_and_holds_what_was_readable(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    raw = (tmp_path / "s.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(raw[: len(raw) * 2 // 3])
    done = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    kept = [item.data for item in SessionReader(tmp_path / "cut.mcap").items()]
    again = SessionReader(tmp_path / "out.mcap")
    assert [item.data for item in again.items()] == kept
    assert done.messages == len(kept) > 100
    assert len(done.damage) == 1
    assert again.complete
    assert again.metadata["session"]["name"] == "test"


@pytest.mark.parametrize("chunked", [True, False])
def test_a_recording_of_another_program_is_recovered_with_its_own_channels(tmp_path: Path, chunked: bool) -> None:
    with (tmp_path / "s.mcap").open("wb") as out:
        writer = Writer(out, use_chunking=chunked)
        writer.start(profile="ros2", library="another program")
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"uint8[] data")
        camera = writer.register_channel("/camera", "cdr", schema)
        for i in range(20):
            writer.add_message(camera, i, bytes([i]) * 50, i)
        writer.finish()
    whole = (tmp_path / "s.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[:-100])
    assert recover(tmp_path / "cut.mcap", tmp_path / "out.mcap").messages == 20
    with (tmp_path / "out.mcap").open("rb") as file:
        again = list(make_reader(file).iter_messages())
    assert [message.data for _, _, message in again] == [bytes([i]) * 50 for i in range(20)]
    assert {(s.name, s.data, c.topic) for s, c, _ in again} == {("sensor_msgs/msg/Image", b"uint8[] data", "/camera")}


def test_where_nothing_can_be_recovered_that_is_said(tmp_path: Path) -> None:
    (tmp_path / "s.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with pytest.raises(InputError, match="no message in it can be read"):
        recover(tmp_path / "s.mcap", tmp_path / "out.mcap")


def random_log(lines: int) -> str:
    """As `candump -l` writes it, with standard, extended and error frames."""
    rng, text, stamp = random.Random(4), "", 1_700_000_000_000_000
    for _ in range(lines):
        stamp += rng.randrange(3000)
        number = rng.choice((f"{rng.randrange(0x800):03X}", f"{rng.randrange(1 << 29):08X}", "20000134"))
        data = rng.randbytes(rng.randrange(9)).hex().upper()
        text += f"({stamp // 10**6}.{stamp % 10**6:06d}) can1 {number}#{data}\n"
    return text


def test_a_candump_log_comes_back_byte_for_byte(tmp_path: Path) -> None:
    """Through a recording: times to the microsecond, extended and error frames, the name of the interface."""
    (tmp_path / "a.log").write_text(random_log(500))
    assert import_log(tmp_path / "a.log", tmp_path / "s.mcap", load_car()).frames == 500
    assert export_candump(tmp_path / "s.mcap", tmp_path / "b.log").rows == 500
    assert (tmp_path / "b.log").read_bytes() == (tmp_path / "a.log").read_bytes()


def test_a_recording_exported_and_imported_keeps_every_frame(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    exported = export_candump(tmp_path / "s.mcap", tmp_path / "s.log")
    assert import_log(tmp_path / "s.log", tmp_path / "again.mcap", load_car()).frames == exported.rows == 500
    before, after = frames_of(tmp_path / "s.mcap"), frames_of(tmp_path / "again.mcap")
    assert [(f.id, f.data, f.stamp_ns // 1000) for f in after] == [(f.id, f.data, f.stamp_ns // 1000) for f in before]


def test_what_a_recording_has_no_place_for_is_counted(tmp_path: Path) -> None:
    lines = ["can0 123#R", "can0 123##311", "can0 123#1122334455667788_9", "can0 12345678#11.22 T", "can0 123#1"]
    (tmp_path / "a.log").write_text("\n".join(f"(1.{i:06d}) {line}" for i, line in enumerate(lines)))
    done = import_log(tmp_path / "a.log", tmp_path / "s.mcap", load_car())
    assert [(f.id, f.data.hex()) for f in frames_of(tmp_path / "s.mcap")] == [
        (0x123, "1122334455667788"),
        (EXTENDED_ID | 0x12345678, "1122"),
    ]
    assert done.left_out == {"remote request": 1, "CAN FD or CAN XL frame": 1, "end that was cut off": 1}


def test_buses_are_never_mixed(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(1.0) can0 001#\n(1.1) can1 002#\n")
    with pytest.raises(InputError, match="holds the channels can0 and can1; choose one with --channel"):
        import_log(tmp_path / "a.log", tmp_path / "s.mcap", load_car())
    done = import_log(tmp_path / "a.log", tmp_path / "s.mcap", load_car(), "can1")
    assert [frame.id for frame in frames_of(tmp_path / "s.mcap")] == [2]
    assert done.left_out == {"frame of another channel": 1}
    with pytest.raises(InputError, match="no CAN frames of channel can2"):
        import_log(tmp_path / "a.log", tmp_path / "s.mcap", load_car(), "can2")


def test_the_name_of_the_exported_file_says_what_it_holds(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    export(tmp_path / "s.mcap", out=tmp_path / "lap.log")
    assert re.match(r"\(\d+\.\d{6}\) \S+ [0-9A-F]{3}#", (tmp_path / "lap.log").read_text())


@pytest.mark.parametrize(("suffix", "resolution_s"), [(".asc", 1e-3), (".blf", 1e-6)])
def test_logs_of_other_tools_are_imported_with_their_date(tmp_path: Path, suffix: str, resolution_s: float) -> None:
    import can

    sent = [can.Message(arbitration_id=i, data=bytes([i]), is_extended_id=i > 4, timestamp=DATE + i) for i in range(9)]
    with can.Logger(tmp_path / f"log{suffix}") as logger:
        for message in sent:
            logger(message)
    assert import_log(tmp_path / f"log{suffix}", tmp_path / "s.mcap", load_car()).frames == len(sent)
    frames = frames_of(tmp_path / "s.mcap")
    assert [f.id & ~EXTENDED_ID for f in frames] == list(range(9))
    assert [bool(f.id & EXTENDED_ID) for f in frames] == [m.is_extended_id for m in sent]
    assert [f.data for f in frames] == [bytes(m.data) for m in sent]
    assert all(abs(f.stamp_ns / 1e9 - m.timestamp) <= resolution_s for f, m in zip(frames, sent, strict=True))


def test_a_blf_log_that_was_cut_off_says_so(tmp_path: Path) -> None:
    import can

    with can.Logger(tmp_path / "a.blf", max_container_size=1000) as logger:
        for i in range(200):
            logger(can.Message(arbitration_id=i, timestamp=DATE + i))
    whole = (tmp_path / "a.blf").read_bytes()
    (tmp_path / "b.blf").write_bytes(whole[: len(whole) // 2])
    assert not import_log(tmp_path / "a.blf", tmp_path / "s.mcap", load_car()).left_out
    done = import_log(tmp_path / "b.blf", tmp_path / "t.mcap", load_car())
    assert 0 < done.frames < 200
    assert done.left_out == {"end that was cut off": 1}


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("x.log", "(1.0) can0 123#11\nnonsense\n", "line 2: not `.seconds. channel identifier#data`"),
        ("x.log", "(1.0) can0 123#112\n", "line 1: '112' is no data"),
        ("x.log", "(1.0) can0 9FF#\n", "line 1: 9FF is no CAN identifier"),
        ("x.log", "(9999999999.0) can0 123#\n", "entry 1: a time before 1970 or after 2038"),
        ("x.log", "", "holds no CAN frames"),
        ("x.txt", "a letter\nof two lines\n", "unknown kind of log"),
        ("absent.log", None, "cannot read: No such file"),
    ],
)
def test_what_is_no_can_log_gets_one_clear_line_and_leaves_no_file(
    tmp_path: Path, name: str, text: str | None, words: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=f"{name}: .*{words}"):
        import_log(tmp_path / name, tmp_path / "s.mcap", load_car())
    assert {p.name for p in tmp_path.iterdir()} <= {name}


COMMANDS: list[Callable[[Path], object]] = [
    lambda s: recover(s, s.with_name("out")),
    lambda s: export_candump(s, s.with_name("out")),
    lambda s: import_log(s.with_name("s.log"), s.with_name("out"), load_car()),
]


@pytest.fixture
def full_disk() -> Iterator[Callable[[int], None]]:
    """Lets no file grow beyond a size: the kernel's refusal is the one of a full disk but for its number."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_disk_is_one_clear_line_and_leaves_what_was_there(
    tmp_path: Path, full_disk: Callable[[int], None], command: Callable[[Path], object]
) -> None:
    recorded(tmp_path / "s.mcap")
    export_candump(tmp_path / "s.mcap", tmp_path / "s.log")
    (tmp_path / "out").write_text("of yesterday")
    before = set(tmp_path.iterdir())
    full_disk(4000)
    with pytest.raises(InputError, match="out: cannot write: File too large; choose another --out"):
        command(tmp_path / "s.mcap")
    assert (tmp_path / "out").read_text() == "of yesterday"
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize("alias", ["itself", "symbolic link", "hard link"])
@pytest.mark.parametrize("command", [recover, export_candump])
def test_what_is_read_is_never_written_over(
    tmp_path: Path, alias: str, command: Callable[[Path, Path], object]
) -> None:
    recorded(tmp_path / "s.mcap")
    before, target = (tmp_path / "s.mcap").read_bytes(), tmp_path / "out.mcap"
    if alias == "itself":
        target = tmp_path / "s.mcap"
    else:
        (os.symlink if alias == "symbolic link" else os.link)(tmp_path / "s.mcap", target)
    with pytest.raises(InputError, match="never written over"):
        command(tmp_path / "s.mcap", target)
    assert (tmp_path / "s.mcap").read_bytes() == before


def test_importing_the_export_of_a_recording_does_not_replace_the_recording(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    before = (tmp_path / "s.mcap").read_bytes()
    export_candump(tmp_path / "s.mcap", tmp_path / "s.log")
    with pytest.raises(InputError, match=r"s\.mcap: there already, .* --out"):
        import_(tmp_path / "s.log")
    assert (tmp_path / "s.mcap").read_bytes() == before


@pytest.mark.parametrize("target", [".", "folder", "file/below", "loop"])
def test_an_output_that_cannot_be_is_one_clear_line(tmp_path: Path, target: str) -> None:
    recorded(tmp_path / "s.mcap")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=r"(cannot write|is a folder).*; choose another --out"):
        export_candump(tmp_path / "s.mcap", tmp_path / target)


def test_a_device_is_written_to_directly(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    writer = SessionWriter(tmp_path / "s.mcap", {}, 10**9)
    writer.add(CAN_TOPIC, pack_frame(Frame(0x514, b"\1", 0), 10**9), 0, 0, 0)
    writer.close(0)
    export_candump(tmp_path / "s.mcap", Path("/dev/stdout"))
    assert capfd.readouterr().out == "(1.000000) can0 514#01\n"
