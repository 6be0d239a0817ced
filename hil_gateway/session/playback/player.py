"""Plays sessions to Zenoh and to CAN: opens both ends, and counts what went where."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.bus.zenoh_bus import HUB, open_bus
from hil_gateway.can_link import LinkStats, open_link
from hil_gateway.config import Config
from hil_gateway.process.clock import SystemClock
from hil_gateway.session.files.configuration import recorded_car
from hil_gateway.session.files.format import named
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.playback.replay import Send, announcing, in_order, replay, to_bus, to_can


@dataclass(frozen=True)
class Played:
    """What was played, and what was not."""

    items: int
    messages: int
    """published on Zenoh"""
    frames: int
    """sent on CAN"""
    refused: int
    """frames the interface did not take"""
    damage: tuple[str, ...]
    """places of the recordings that could not be read"""


def play(files: Sequence[Path], config: Config, topics: Sequence[str], frames: bool, speed: float) -> Played:
    """Play the parts of a session one after the other: `topics` to Zenoh, and with `frames` those of a car to CAN.

    Raises:
        InputError: unreadable recording, unknown topic, no such interface, busy port.
    """
    sends: list[Send] = []
    items = messages = 0
    damage: list[str] = []

    def send(item: Item) -> None:
        nonlocal messages
        for one in sends:
            one(item)
        messages += item.topic in topics

    with ExitStack() as ends:
        if topics:
            bus = ends.enter_context(closing(open_bus(config.zenoh, HUB)))
            sends += [to_bus(bus, topics), announcing(bus, files[0].name, speed, SystemClock())]
        link = ends.enter_context(closing(open_link(config.can))) if frames else None
        if link:
            sends.append(to_can(link, recorded_car(files).codec.sent_by("car")))
        for file in files:
            reader = SessionReader(file)
            with named(file):
                items += replay(in_order(reader.items()), send, SystemClock(), speed)
            damage += [f"{file}: {place}" for place in reader.damage]
        stats = link.stats() if link else LinkStats()
    return Played(items, messages, stats.sent, stats.send_failures, tuple(damage))
