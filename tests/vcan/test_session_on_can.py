"""Recordings and the demo on a real CAN interface, next to programs that are not ours."""

from __future__ import annotations

import random
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hil_gateway.can_link import Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.can_link.socketcan import SocketCanLink
from hil_gateway.car.car import load_car
from hil_gateway.demo.options import DemoOptions, prepare
from hil_gateway.process.clock import SystemClock
from hil_gateway.session.exchange.export import export_candump
from hil_gateway.session.exchange.importer import import_log
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionWriter
from hil_gateway.session.playback.replay import in_order, replay, to_can

pytestmark = pytest.mark.vcan
FRAMES = 60


def _session(path: Path) -> list[Frame]:
    """A recording of random frames of a car, 2 ms apart."""
    rng, numbers = random.Random(5), sorted(load_car().codec.sent_by("car"))
    frames = [Frame(rng.choice(numbers), rng.randbytes(8), 10**18 + i * 2_000_000) for i in range(FRAMES)]
    writer = SessionWriter(path, {}, 10**9)
    for i, frame in enumerate(frames):
        writer.add(CAN_TOPIC, pack_frame(frame, frame.stamp_ns), frame.stamp_ns, frame.stamp_ns, i)
    writer.close(0)
    return frames


def test_candump_hears_a_replayed_session_frame_by_frame_and_it_imports_again(
    channel: str, open_socketcan: Callable[[], SocketCanLink], tmp_path: Path
) -> None:
    frames = _session(tmp_path / "s.mcap")
    link = open_socketcan()
    log = tmp_path / "candump.log"
    with (
        log.open("w") as file,
        subprocess.Popen(["candump", "-L", "-n", str(FRAMES), channel], stdout=file) as listener,
    ):
        time.sleep(1.0)
        replay(
            in_order(SessionReader(tmp_path / "s.mcap").items()),
            to_can(link, load_car().codec.sent_by("car")),
            SystemClock(),
            speed=1.0,
        )
        listener.wait(timeout=20)
    exported = tmp_path / "exported.log"
    export_candump(tmp_path / "s.mcap", exported)
    heard, wanted = ([line.split()[2] for line in path.read_text().splitlines()] for path in (log, exported))
    assert heard == wanted
    assert import_log(log, tmp_path / "again.mcap", load_car()).frames == len(frames)
    assert len(list(SessionReader(tmp_path / "again.mcap").items())) == len(frames)


def test_canplayer_plays_an_exported_session(
    channel: str, open_socketcan: Callable[[], SocketCanLink], tmp_path: Path
) -> None:
    frames = _session(tmp_path / "s.mcap")
    export_candump(tmp_path / "s.mcap", tmp_path / "s.log")
    link = open_socketcan()
    subprocess.run(["canplayer", "-I", str(tmp_path / "s.log"), f"{channel}=can0"], check=True, timeout=30)
    heard = link.receive(2.0)
    assert [(f.id, bytes(f.data)) for f in heard] == [(f.id, f.data) for f in frames]


def test_the_demo_uses_vcan0_by_itself_and_says_so(channel: str, tmp_path: Path) -> None:
    """`channel` only proves that this kernel has SocketCAN; vcan0 is what deploy/with-vcan provides."""
    setup = prepare(DemoOptions(out=tmp_path))
    setup.lock.release()
    assert setup.bus == "socketcan vcan0"
    assert setup.config.can.interface == "auto"
