"""R1: a recorder killed without warning loses at most 200 ms, and the rest is read without repair."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.promise_figures import record_figure, volume

from hil_gateway.session.files.format import CAN_TOPIC, unpack_frame
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.recover import recover

KILLS = volume(5, 100)
PROMISED_S = 0.2
MESSAGES_AT_ONCE = 20

RECORDER = """
import sys
from pathlib import Path
from hil_gateway.bus.interface import LocalBus
from hil_gateway.can_link import VirtualWire
from hil_gateway.process.clock import SystemClock
from hil_gateway.config import RecorderConfig
from hil_gateway.session.recorder import Recorder
from hil_gateway.session.files.writer import SessionWriter

clock, bus = SystemClock(), LocalBus()
wire = VirtualWire(clock)
car, link = wire.link(), wire.link()
config = RecorderConfig()
recorder = Recorder(config, bus, link, SessionWriter(Path(sys.argv[1]), {}, 10**9), 0, sent=())
number, begin_ns = 0, clock.now_ns()
while True:
    for _ in range(20):
        car.send(0x100, number.to_bytes(8, "little"))
        number += 1
    now_ns = clock.now_ns()
    print(number, now_ns, flush=True)
    recorder.step(now_ns)
    clock.sleep_until(now_ns + 10_000_000)
"""


def _record_and_kill(path: Path, after_s: float) -> tuple[list[tuple[int, int]], int]:
    """(number of frames sent, when) after each step, and the time of the kill, ns."""
    process = subprocess.Popen([sys.executable, "-c", RECORDER, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    first = process.stdout.readline()
    time.sleep(after_s)
    killed_ns = time.monotonic_ns()
    process.kill()
    lines = [first, *process.stdout.read().splitlines()]
    process.wait()
    process.stdout.close()
    steps = [line.split() for line in lines if len(line.split()) == 2]
    return [(int(number), int(at_ns)) for number, at_ns in steps], killed_ns


@pytest.mark.promise("R1")
def test_kill_9_loses_at_most_200_ms_and_the_rest_is_recovered(tmp_path: Path) -> None:
    rng, worst_s = random.Random(3), 0.0
    for kill in range(KILLS):
        path = tmp_path / f"{kill}.mcap"
        steps, killed_ns = _record_and_kill(path, rng.uniform(0.15, 0.9))
        reader = SessionReader(path)
        frames = [unpack_frame(item.data) for item in reader.items() if item.topic == CAN_TOPIC]
        numbers = [int.from_bytes(frame.data, "little") for frame in frames]
        assert numbers == list(range(len(numbers)))
        lost = [at_ns for number, at_ns in steps if number > len(numbers)]
        worst_s = max(worst_s, (killed_ns - min(lost, default=killed_ns)) / 1e9)
        assert worst_s <= PROMISED_S
        assert not reader.complete
        assert recover(path, tmp_path / f"{kill}_recovered.mcap").messages >= len(numbers)
    record_figure("R1", f"{KILLS} kills, at most {1e3 * worst_s:.0f} ms lost")
