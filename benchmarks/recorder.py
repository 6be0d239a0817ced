"""Recording and reading raw frames: processor time per frame against python-can's own log writers, same run.

python-can's writers keep no index, checksum nothing and lose what is in their buffer when killed: they show what that
costs. Exits 1 when reading is not `REQUIRED` times as fast as the mcap package's own reader.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import can
from mcap.reader import make_reader

from hil_gateway.can_link import Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionWriter

FRAMES = 60_000
PER_FLUSH = 600
"""a tenth of a second of a full bus"""
REPEATS = 3
REQUIRED = 1.5


def frames() -> list[Frame]:
    """Ten seconds of a full bus: 60 identifiers, slowly changing data."""
    rng = random.Random(1)
    base = [rng.randbytes(4) for _ in range(60)]
    return [Frame(0x500 + i % 60, base[i % 60] + (i // 60).to_bytes(4, "little"), i * 160_000) for i in range(FRAMES)]


def record(path: Path, sent: list[Frame]) -> None:
    """As the recorder does it: CDR, chunks of 100 ms, checksums, Zstandard."""
    writer = SessionWriter(path, {}, rotate_bytes=10**12)
    for number, frame in enumerate(sent):
        writer.add(CAN_TOPIC, pack_frame(frame, frame.stamp_ns), frame.stamp_ns, frame.stamp_ns, number)
        if number % PER_FLUSH == 0:
            writer.flush(frame.stamp_ns)
    writer.close(0)


def record_with(writer: Callable[[Path], can.Listener], path: Path, messages: list[can.Message]) -> None:
    """Through a log writer of python-can."""
    log = writer(path)
    for message in messages:
        log.on_message_received(message)
    log.stop()


def read_own(path: Path) -> int:
    """Frames our linear reader gives."""
    return sum(1 for _ in SessionReader(path).items())


def read_with_mcap(path: Path) -> int:
    """Frames the mcap package's reader gives, in the order of the file."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))


def best_us(action: Callable[[], object]) -> float:
    """Processor time of the quickest of `REPEATS` runs, us a frame."""
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return 1e6 * min(times) / FRAMES


def main() -> int:
    """Print the table; 1 when the ratio is missed."""
    sent = frames()
    messages = [
        can.Message(f.stamp_ns / 1e9, f.id, is_extended_id=False, data=f.data, dlc=len(f.data), check=False)
        for f in sent
    ]
    with tempfile.TemporaryDirectory() as folder:
        own, blf, log = (Path(folder) / name for name in ("s.mcap", "s.blf", "s.log"))
        record_us = best_us(lambda: record(own, sent))
        blf_us = best_us(lambda: record_with(can.BLFWriter, blf, messages))
        log_us = best_us(lambda: record_with(can.CanutilsLogWriter, log, messages))
        assert read_own(own) == read_with_mcap(own) == FRAMES
        read_us, mcap_us = best_us(lambda: read_own(own)), best_us(lambda: read_with_mcap(own))
        print(f"record  {record_us:4.1f} us a frame, {own.stat().st_size / FRAMES:.1f} B")
        for name, cost_us, path in (("BLF", blf_us, blf), ("candump", log_us, log)):
            size, ratio = path.stat().st_size / FRAMES, record_us / cost_us
            print(f"  python-can {name:8} {cost_us:4.1f} us, {size:.1f} B: ours costs {ratio:.1f} times that")
        ratio = mcap_us / read_us
        print(f"read    {read_us:4.1f} us a frame")
        print(f"  mcap package        {mcap_us:4.1f} us: ours is {ratio:.1f} times as fast (required {REQUIRED:g})")
    return int(ratio < REQUIRED)


if __name__ == "__main__":
    sys.exit(main())
