"""A recorder with a car and a commander on a virtual clock, for tests of recordings."""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import Command
from hil_gateway.bus.topics import COMMAND
from hil_gateway.can_link import VirtualWire
from hil_gateway.car.car import load_car
from hil_gateway.config import RecorderConfig
from hil_gateway.process.clock import VirtualClock
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionWriter
from hil_gateway.session.recorder import Recorder

UNIX_NS = 1_700_000_000 * 10**9
CONFIG = RecorderConfig(min_free_bytes=0)


class Rig:
    """A recorder on a virtual clock, with a car that sends `frames_per_step` frames and a command every 10 ms."""

    def __init__(self, path: Path, write: Any = os.write, rotate_bytes: int = 10**9) -> None:
        self.clock, self.bus = VirtualClock(), LocalBus()
        wire = VirtualWire(self.clock)
        self.car = wire.link()
        writer = SessionWriter(
            path, {"name": "test", "config": "{}"}, rotate_bytes, write=write, attached=load_car().files()
        )
        self.recorder = Recorder(
            CONFIG, self.bus, wire.link(), writer, UNIX_NS, sent=load_car().codec.sent_by("computer")
        )
        self.sent = 0
        self.rng = random.Random(1)

    def run(self, steps: int, frames_per_step: int = 5) -> Rig:
        for _ in range(steps):
            now_ns = self.clock.now_ns()
            for _ in range(frames_per_step):
                self.car.send(self.rng.randrange(0x7FF), self.rng.randbytes(8))
            self.bus.publish(
                COMMAND, Command(stamp_ns=now_ns, seq=self.sent, source="t", state_stamp_ns=now_ns, steer=0, drive=0)
            )
            self.sent += frames_per_step + 1
            self.recorder.step(now_ns)
            self.clock.advance(10_000_000)
        return self


def recorded(path: Path) -> SessionWriter:
    """A session of one second, closed in order."""
    rig = Rig(path).run(100)
    rig.recorder.close(rig.clock.now_ns())
    return rig.recorder.writer


def sent_items(path: Path) -> int:
    return sum(item.topic in (CAN_TOPIC, COMMAND.key) for item in SessionReader(path).items())
