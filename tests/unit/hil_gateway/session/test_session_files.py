"""Sessions are written, read, cut, damaged, recovered, exported and imported."""

from __future__ import annotations

import errno
import json
import os
import random
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from support.cars.session_rig import UNIX_NS, Rig, recorded, sent_items
from support.promise_figures import record_figure, volume

from can_dbc.codec import load_codec
from can_dbc.folder import SHIPPED
from hil_gateway.bus.messages import Command, ModelRevision
from hil_gateway.bus.topics import COMMAND, MODEL_REVISION, TOPICS
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError
from hil_gateway.session.files import two_readers
from hil_gateway.session.files.format import CAN_TOPIC, MessageError, recorded_source, software_version, unpack_frame
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionWriter
from hil_gateway.session.overview.info import session_info

ROOT = Path(__file__).resolve().parents[4]


def test_session_opens_with_the_mcap_reader_and_has_a_channel_for_every_topic(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    with (tmp_path / "s.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        topics = {channel.topic for channel in summary.channels.values()}
        assert topics == {CAN_TOPIC, *(t.key for t in TOPICS if t.recorded)}
        attached = {a.name: a.data for a in reader.iter_attachments()}
        assert set(attached) == {"av24.dbc", "bus.toml", "signals.toml", "car.toml"}
        assert attached["av24.dbc"] == (SHIPPED / "av24" / "av24.dbc").read_bytes(), "frames decode without us"
        for schema, channel, message in reader.iter_messages(topics=[COMMAND.key]):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert json.loads(schema.data)["title"] == "Command"
            assert Command.model_validate_json(message.data).source == "t"
            assert message.publish_time >= UNIX_NS


def test_a_recording_made_in_a_checkout_names_the_commit() -> None:
    command = ["git", "-C", str(ROOT), "rev-parse", "--short=12", "HEAD"]
    asked = subprocess.run(command, capture_output=True, text=True, check=False)
    if asked.returncode:
        pytest.skip(f"no checkout that git reads: {asked.stderr}")
    assert asked.stdout.strip() in software_version()


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x123, b"\x01\x02\x03", 0),
        Frame(0x7FF, b"", 0),
        Frame(EXTENDED_ID | 0x123, bytes(8), 0),
        Frame(0x40, bytes(range(8)), 0, is_error=True),
    ],
)
def test_raw_frames_survive_cdr(frame: Frame) -> None:
    frame.stamp_ns = UNIX_NS + 123_456_789
    assert unpack_frame(pack_frame(frame, frame.stamp_ns)) == frame


def test_raw_frames_decode_with_the_published_message_definition() -> None:
    """Field by field after the CDR rules (OMG DDSI-RTPS 9.4), independent of the packing code."""
    cdr = pack_frame(Frame(0x514, bytes(range(6)), 0), 5 * 10**9 + 7)
    assert cdr[:4] == b"\0\1\0\0"
    body = cdr[4:]
    assert int.from_bytes(body[0:4], "little") == 5
    assert int.from_bytes(body[4:8], "little") == 7
    assert int.from_bytes(body[8:12], "little") == 1
    assert body[12] == 0
    assert int.from_bytes(body[16:20], "little") == 0x514
    assert (body[20], body[21], body[22], body[23]) == (0, 0, 0, 6)
    assert body[24:32] == bytes(range(6)) + b"\0\0"
    assert len(body) == 32


def test_every_recorded_frame_says_its_bus_and_who_sends_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "s.mcap")
    for message in load_codec().messages.values():
        rig.car.send(message.id, bytes(message.dlc))
    rig.run(1, frames_per_step=0).recorder.close(rig.clock.now_ns())
    items = [item for item in SessionReader(tmp_path / "s.mcap").items() if item.topic == CAN_TOPIC]
    directions = {unpack_frame(item.data).id: recorded_source(item.data) for item in items}
    sent = {message.id: message.sender for message in load_codec().messages.values()}
    assert directions == {number: "wire/tx" if who == "COMPUTER" else "wire/rx" for number, who in sent.items()}


@pytest.mark.parametrize("source", ["", "can0/rx", "a" * 60, "é/rx"])
def test_a_frame_of_any_source_decodes_with_the_published_definition(source: str) -> None:
    """A CDR string: length with its NUL, characters, NUL, then padding to four (OMG DDSI-RTPS 9.4)."""
    frame = Frame(0x514, bytes(range(6)), 10**9)
    cdr = pack_frame(frame, frame.stamp_ns, source)
    length = int.from_bytes(cdr[12:16], "little")
    after = 16 + length + -length % 4
    assert cdr[16 : 16 + length].decode() == source.replace("é", "?") + "\0"
    assert (int.from_bytes(cdr[after : after + 4], "little"), cdr[after + 7]) == (0x514, 6)
    assert unpack_frame(cdr) == frame


@pytest.mark.parametrize("cdr", [b"", bytes(8), bytes(36), b"\0\1\0\0" + bytes(8) + b"\xff" * 4 + bytes(20)])
def test_bytes_that_are_no_recorded_frame_are_a_clear_error(cdr: bytes) -> None:
    with pytest.raises(MessageError, match="no can_msgs/msg/Frame"):
        unpack_frame(cdr)


@pytest.mark.promise("R2")
def test_a_disk_that_fails_at_any_write_costs_only_counted_messages(tmp_path: Path) -> None:
    """For every N the Nth write fails, then the disk works again: every message is on disk or counted lost."""

    def run(fail_at: int) -> tuple[int, Rig]:
        calls = 0

        def write(fd: int, data: bytes) -> int:
            nonlocal calls
            calls += 1
            if calls == fail_at:
                os.write(fd, data[: len(data) // 2])
                raise OSError(errno.ENOSPC, "No space left on device")
            return os.write(fd, data)

        rig = Rig(tmp_path / f"n{fail_at}.mcap", write).run(160, frames_per_step=2)
        rig.recorder.close(rig.clock.now_ns())
        return calls, rig

    calls, _ = run(0)
    assert calls > 10
    for fail_at in range(1, calls + 1):
        _, rig = run(fail_at)
        files = sorted(tmp_path.glob(f"n{fail_at}[._]*"))
        status = rig.recorder.status(rig.clock.now_ns())
        on_disk = sum(sent_items(path) for path in files)
        own_status_messages = status.frames + status.messages + status.lost - rig.sent
        assert 0 <= own_status_messages <= 3
        assert on_disk <= rig.sent <= on_disk + status.lost
        assert status.errors == 1
        assert "No space left" in status.last_error
        assert all(not SessionReader(path).damage for path in files)
    record_figure("R2", f"each of {calls} writes failed once: every message on disk or counted lost")


@pytest.mark.promise("R2")
def test_a_disk_that_stays_broken_never_raises_and_every_loss_is_counted(tmp_path: Path) -> None:
    def write(fd: int, data: bytes) -> int:
        raise OSError(errno.EIO, "Input/output error")

    rig = Rig(tmp_path / "s.mcap", write).run(300)
    rig.recorder.close(rig.clock.now_ns())
    status = rig.recorder.status(rig.clock.now_ns())
    assert status.lost >= rig.sent
    assert status.frames == status.messages == 0
    assert status.errors >= 3
    assert not status.recording


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 128 KiB."""
    target = tmp_path / "small"
    target.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", target], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("may not mount a file system here: run as root")
    yield target
    subprocess.run(["umount", str(target)], check=True)


@pytest.mark.promise("R2")
def test_a_disk_that_is_really_full_leaves_a_readable_recording_and_says_so(small_disk: Path) -> None:
    rig = Rig(small_disk / "s.mcap").run(400, frames_per_step=20)
    rig.recorder.close(rig.clock.now_ns())
    status = rig.recorder.status(rig.clock.now_ns())
    assert "No space left on device" in status.last_error
    assert 0 < sent_items(small_disk / "s.mcap") < rig.sent
    assert status.lost >= rig.sent - sum(map(sent_items, small_disk.glob("*.mcap")))
    assert not SessionReader(small_disk / "s.mcap").damage


def test_recording_pauses_below_the_free_space_it_must_leave(tmp_path: Path) -> None:
    writer = SessionWriter(tmp_path / "s.mcap", {}, 10**9, min_free_bytes=10**18)
    for _ in range(3):
        writer.flush(0)
        writer.add(CAN_TOPIC, b"", 0, 0, 0)
    assert writer.lost == 3
    assert not writer.recording
    assert (writer.errors, "MB free on this disk" in writer.last_error) == (1, True), "said, and said once"


def test_rotation_begins_a_new_complete_file_and_loses_nothing(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "s.mcap", rotate_bytes=20_000).run(300, frames_per_step=10)
    rig.recorder.close(rig.clock.now_ns())
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) > 2
    assert sum(map(sent_items, files)) == rig.sent
    for number, path in enumerate(files):
        info = session_info(path, car=load_car())
        assert info["complete"]
        assert info["session"]["part"] == str(number)


def test_new_model_revision_is_noted_in_the_metadata(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "s.mcap").run(20)
    revision = ModelRevision(stamp_ns=0, seq=0, revision="abc", layout="shared", tyre={})
    rig.bus.publish(MODEL_REVISION, revision)
    rig.run(20).recorder.close(rig.clock.now_ns())
    assert session_info(tmp_path / "s.mcap", car=load_car())["model_revision"]["revision"] == "abc"


@pytest.mark.promise("R3")
def test_a_recording_cut_at_any_byte_of_its_last_64_kib_gives_every_whole_chunk(tmp_path: Path) -> None:
    """What is read is exactly the chunks that are whole, and nothing is ever raised; HIL_LONG=1 tries every byte."""
    path, cut, rng = tmp_path / "s.mcap", tmp_path / "cut.mcap", random.Random(2)
    writer = SessionWriter(path, {"name": "test"}, rotate_bytes=10**9)
    for number in range(90):
        writer.add(COMMAND.key, rng.randbytes(900), UNIX_NS + number, UNIX_NS + number, number)
        if number % 4 == 3:
            writer.flush(0)
    writer.close(0)
    whole = path.read_bytes()
    full = [item.data for item in SessionReader(path).items()]
    ends = [end for _, end in chunk_spans(whole)]
    per_chunk = items_per_chunk(whole)
    first = len(whole) - 65536
    assert first > 1000
    cut.write_bytes(whole)
    sizes = range(len(whole) - 1, first - 1, -volume(97, 1))
    for size in sizes:
        os.truncate(cut, size)
        reader = SessionReader(cut)
        data = [item.data for item in reader.items()]
        assert data == full[: sum(n for end, n in zip(ends, per_chunk, strict=True) if end <= size)]
        assert not reader.complete
    record_figure("R3", f"cut at {len(sizes)} of the last 65,536 bytes: every whole chunk read, nothing raised")


def chunk_spans(raw: bytes) -> list[tuple[int, int]]:
    """Byte ranges of the chunk records, by walking the record headers."""
    spans, position = [], 8
    while position < len(raw) - 8:
        opcode, length = raw[position], int.from_bytes(raw[position + 1 : position + 9], "little")
        if opcode == 6:
            spans.append((position, position + 9 + length))
        position += 9 + length
    return spans


def items_per_chunk(raw: bytes) -> list[int]:
    """Messages of each chunk, by the length of the index records behind it: 16 bytes for each message."""
    counts, position = [], 8
    while position < len(raw) - 8:
        opcode, length = raw[position], int.from_bytes(raw[position + 1 : position + 9], "little")
        if opcode == 6:
            counts.append(0)
        elif opcode == 7:
            counts[-1] += (length - 6) // 16
        position += 9 + length
    return counts


@pytest.mark.promise("R3")
@pytest.mark.parametrize("where", ["data", "header", "length"])
def test_a_corrupt_chunk_is_named_and_the_rest_is_read(tmp_path: Path, where: str) -> None:
    recorded(tmp_path / "s.mcap")
    raw = bytearray((tmp_path / "s.mcap").read_bytes())
    start, end = chunk_spans(bytes(raw))[4]
    offset = {"data": (start + end) // 2, "header": start + 34, "length": start + 5}[where]
    raw[offset] ^= 0x5A
    (tmp_path / "bad.mcap").write_bytes(raw)
    lost = items_per_chunk((tmp_path / "s.mcap").read_bytes())[4]
    reader = SessionReader(tmp_path / "bad.mcap")
    total = len(list(SessionReader(tmp_path / "s.mcap").items()))
    assert len(list(reader.items())) == total - lost
    assert [d.offset for d in reader.damage] == [start]
    assert reader.complete


def test_an_index_that_is_wrong_hides_no_message_of_its_chunk_or_of_others(tmp_path: Path) -> None:
    """Chunks are read together: the places of one that are no messages are looked for, those of the others are used."""
    recorded(tmp_path / "s.mcap")
    raw = bytearray((tmp_path / "s.mcap").read_bytes())
    whole = [item.data for item in SessionReader(tmp_path / "s.mcap").items()]
    _, index = chunk_spans(bytes(raw))[1]
    assert raw[index] == 7
    raw[index + 9 + 6 + 8] ^= 0x05  # place of the first message of the first index behind the second chunk
    (tmp_path / "bad.mcap").write_bytes(raw)
    reader = SessionReader(tmp_path / "bad.mcap")
    assert [item.data for item in reader.items()] == whole
    assert [damage.what for damage in reader.damage] == [
        "what lies between the chunks is corrupt: its checksum is wrong; every message is whole"
    ]


@pytest.mark.promise("R3")
def test_first_chunk_corrupt_still_gives_the_other_chunks_with_their_topics(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    raw = bytearray((tmp_path / "s.mcap").read_bytes())
    start, end = chunk_spans(bytes(raw))[0]
    raw[(start + end) // 2] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(raw)
    topics = {item.topic for item in SessionReader(tmp_path / "bad.mcap").items()}
    assert {CAN_TOPIC, COMMAND.key} <= topics
    assert topics <= {CAN_TOPIC, *(t.key for t in TOPICS)}


@pytest.mark.promise("R3")
@pytest.mark.parametrize(("changed", "what"), [(b"config", "between the chunks"), (b"jsonschema", "the index")])
def test_a_changed_byte_outside_the_chunks_is_named_too(tmp_path: Path, changed: bytes, what: str) -> None:
    """In the metadata, whose text has no checksum of its own, and in the index at the end."""
    recorded(tmp_path / "s.mcap")
    raw = bytearray((tmp_path / "s.mcap").read_bytes())
    raw[raw.index(changed) + 1] ^= 1
    (tmp_path / "bad.mcap").write_bytes(raw)
    info = session_info(tmp_path / "bad.mcap", car=load_car())
    assert (info["complete"], info["corrupt"], len(info["damage"])) == (True, True, 1)
    assert what in info["damage"][0]
    assert info["messages"] == session_info(tmp_path / "s.mcap", car=load_car())["messages"]


def test_a_recording_that_was_only_cut_is_not_corrupt(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    raw = (tmp_path / "s.mcap").read_bytes()
    for size in (len(raw) // 2, len(raw) - 4, len(raw) - 300):
        (tmp_path / "cut.mcap").write_bytes(raw[:size])
        info = session_info(tmp_path / "cut.mcap", car=load_car())
        assert (info["complete"], info["corrupt"], len(info["damage"])) == (False, False, 1)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.mcap", None, "No such file"),
        ("text.mcap", b"hello", "unknown kind of log"),
    ],
)
def test_what_is_no_recording_gets_one_clear_line(tmp_path: Path, name: str, content: bytes | None, words: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        session_info(tmp_path / name, car=load_car())


def test_two_readers_in_turn_say_what_one_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of files that are cut off or damaged, at places in the pieces of either."""
    path = tmp_path / "s.mcap"
    rig = Rig(path).run(600)
    rig.recorder.close(rig.clock.now_ns())
    whole, shared = path.read_bytes(), list[bool]()
    hurt = [whole[:at] + bytes(40) + whole[at + 40 :] for at in range(10_000, len(whole), len(whole) // 5)]
    go_on = SessionReader.go_on_behind
    monkeypatch.setattr(SessionReader, "go_on_behind", lambda *pair: shared.append(go_on(*pair)) or shared[-1])
    monkeypatch.setattr(two_readers, "PIECE_BYTES", len(whole) // 20)
    for raw in (whole, whole[: len(whole) * 3 // 4], *hurt):
        path.write_bytes(raw)
        monkeypatch.setattr(two_readers, "LONG_BYTES", len(raw) + 1)
        alone = session_info(path, car=load_car())
        monkeypatch.setattr(two_readers, "LONG_BYTES", 0)
        assert session_info(path, car=load_car()) == alone
    assert True in shared
    assert False in shared
