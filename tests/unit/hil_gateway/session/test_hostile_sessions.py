"""Recordings of other programs and versions, damaged metadata, killed recorders: one clear line, nothing lost."""

from __future__ import annotations

import functools
import os
import random
from pathlib import Path
from typing import Any

import can
import pytest
from mcap.writer import CompressionType, Writer
from support.cars.session_rig import Rig, recorded, sent_items

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import COMMAND
from hil_gateway.car.car import load_car
from hil_gateway.process.clock import VirtualClock
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.export import export_candump
from hil_gateway.session.exchange.importer import import_log
from hil_gateway.session.files import writer as writer_module
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.recover import recover
from hil_gateway.session.files.writer import SessionFile, SessionWriter
from hil_gateway.session.logs.reading import open_log
from hil_gateway.session.overview.info import session_info
from hil_gateway.session.playback.replay import in_order, replay, to_bus


def test_a_restarted_recorder_never_writes_over_what_it_left(tmp_path: Path) -> None:
    """A killed one is back within 0.2 s, in the same second and perhaps under a configured name."""
    first = Rig(tmp_path / "s.mcap").run(50)
    before = sent_items(tmp_path / "s.mcap")
    second = recorded(tmp_path / "s.mcap")
    assert sent_items(tmp_path / "s.mcap") == before > 0
    assert second.path == tmp_path / "s_001.mcap"
    first.recorder.close(first.clock.now_ns())


def test_recorders_of_one_name_and_links_that_lead_nowhere_never_meet_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "s.mcap").symlink_to(tmp_path / "elsewhere")
    rigs = [Rig(tmp_path / "s.mcap").run(20) for _ in range(3)]
    for rig in rigs:
        rig.recorder.close(rig.clock.now_ns())
    names = [rig.recorder.writer.path.name for rig in rigs]
    assert names == ["s_001.mcap", "s_002.mcap", "s_003.mcap"]
    assert [sent_items(tmp_path / name) for name in names] == [rig.sent for rig in rigs]
    assert not (tmp_path / "elsewhere").exists()


def test_a_folder_that_cannot_be_written_is_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    Rig(tmp_path / "file" / "s.mcap").run(300)
    assert [record.getMessage() for record in caplog.records] == [
        f"not recording in {tmp_path / 'file'}: s.mcap: File exists"
    ]


def rewritten(source: Path, target: Path, change: Any) -> Path:
    """`source` with `change(topic, data)` as the data of every message, in chunks with right checksums."""
    with SessionFile(target, {}) as file:
        for item in SessionReader(source).items():
            data = change(item.topic, item.data)
            file.add(item.topic, data, item.log_ns, item.publish_ns, item.sequence)
    return target


def test_messages_of_another_version_and_frames_of_another_program_are_one_clear_line(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    other = rewritten(tmp_path / "s.mcap", tmp_path / "o.mcap", lambda topic, data: b'{"nonsense": 1}')
    with pytest.raises(InputError, match=r"o\.mcap: av24/can: a record of 15 bytes .* another program"):
        export_candump(other, tmp_path / "o.log")
    send = to_bus(LocalBus(), [COMMAND.key])
    with pytest.raises(InputError, match="av24/command: a message this version cannot read: field required"):
        replay(in_order(SessionReader(other).items()), send, VirtualClock(), speed=0)


@pytest.mark.parametrize("name", ["s.mcap", "s.log", "s.asc", "s.blf"])
def test_a_pipe_is_no_recording_and_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="a pipe, socket or device; write it to a file first"):
        list(SessionReader(tmp_path / name).items() if name == "s.mcap" else open_log(tmp_path / name).frames())


def test_damaged_metadata_is_named(tmp_path: Path) -> None:
    writer = SessionWriter(tmp_path / "s.mcap", {"name": "test", "config": "{\x00"}, 10**9)
    writer.close(0)
    info = session_info(tmp_path / "s.mcap", car=load_car())
    assert info["config"] == {}
    assert info["damage"] == ["the configuration in the metadata is not readable"]


def test_chunks_without_checksums_are_read_as_far_as_they_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a program that writes neither: lengths inside a chunk may be anything then."""
    with monkeypatch.context() as other_program:
        plain = functools.partial(Writer, compression=CompressionType.NONE, enable_crcs=False)
        other_program.setattr(writer_module, "Writer", lambda sink, **_: plain(sink))
        recorded(tmp_path / "s.mcap")
    whole, rng = (tmp_path / "s.mcap").read_bytes(), random.Random(6)
    corrupt = 0
    for _ in range(200):
        raw = bytearray(whole)
        for _ in range(20):
            raw[rng.randrange(200, len(raw) - 5000)] = rng.randrange(256)
        (tmp_path / "bad.mcap").write_bytes(raw)
        corrupt += any("chunk" in damage for damage in session_info(tmp_path / "bad.mcap", car=load_car())["damage"])
    assert corrupt > 5


def damaged(whole: bytes, rng: random.Random) -> bytes:
    """`whole` with some bytes changed, lost, doubled or added, or cut short."""
    data = bytearray(whole)
    for _ in range(rng.choice((1, 3, 20))):
        at, length = rng.randrange(len(data)), rng.choice((1, 8, 200))
        match rng.randrange(5):
            case 0:
                data[at] = rng.randrange(256)
            case 1:
                data[at : at + length] = bytes(length)
            case 2:
                data[at:at] = rng.randbytes(length)
            case 3:
                data[at : at + 8] = b"\xff" * 8
            case _:
                del data[max(at, 1) : None if rng.random() < 0.2 else at + length]
    return bytes(data)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # python-can leaves the file open
@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_a_damaged_log_of_another_tool_is_imported_or_refused_in_one_line(tmp_path: Path, suffix: str) -> None:
    rng, good, bad = random.Random(suffix), tmp_path / f"good{suffix}", tmp_path / f"bad{suffix}"
    with can.Logger(good) as logger:
        for i in range(100):
            frame = rng.randbytes(rng.randrange(9))
            logger(can.Message(arbitration_id=i, data=frame, is_extended_id=False, timestamp=1.7e9 + i, channel=0))
    refused = 0
    for _ in range(60):
        bad.write_bytes(damaged(good.read_bytes(), rng))
        try:
            import_log(bad, tmp_path / "s.mcap", load_car())
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 0


def test_a_session_damaged_anywhere_is_read_as_far_as_it_goes_or_refused_in_one_line(tmp_path: Path) -> None:
    rng, bad = random.Random(5), tmp_path / "bad.mcap"
    recorded(tmp_path / "s.mcap")
    whole = (tmp_path / "s.mcap").read_bytes()
    readable = 0
    for _ in range(100):
        bad.write_bytes(damaged(whole, rng))
        try:
            readable += session_info(bad, car=load_car())["messages"] > 0
            recover(bad, tmp_path / "r.mcap")
            export_candump(bad, tmp_path / "o.log")
        except InputError as error:
            assert "\n" not in str(error)
    assert readable > 50
