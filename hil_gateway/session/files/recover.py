"""Makes a complete file of whatever a damaged one still holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError
from hil_gateway.session.files.configuration import config_of
from hil_gateway.session.files.format import METADATA_SESSION
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.files.writer import PENDING_LIMIT, SessionFile

Make = Callable[[Item], Iterable[tuple[str, bytes]]]
"""(topic, data) of messages made of a recorded one"""


def _nothing(item: Item) -> Iterable[tuple[str, bytes]]:
    return ()


def _as_recorded(item: Item) -> bytes:
    return item.data


def _as_they_are(name: str, values: dict[str, str]) -> dict[str, str]:
    return values


@dataclass(frozen=True)
class Recovered:
    """What became of a damaged file."""

    messages: int
    damage: tuple[str, ...]


def recover(
    source: Path, target: Path, further: Mapping[str, tuple[str, bytes]] | None = None, make: Make = _nothing,
    *, data: Callable[[Item], bytes] = _as_recorded,
    metadata: Callable[[str, dict[str, str]], dict[str, str]] = _as_they_are,
) -> Recovered:  # fmt: skip
    """Copy every readable message of `source` to `target`, with what `make` makes of each on the topics `further`.

    `data` and `metadata` (by its name) may change what is copied.

    Raises:
        InputError: `source` is no recording or nothing in it can be read, or `target` cannot be written.
    """
    reader = SessionReader(source)
    items = reader.items()
    first = next(items, None)
    if first is None:
        reason = "; ".join(map(str, reader.damage)) or "it holds none"
        raise InputError(f"{source}: no message in it can be read: {reason}")
    foreign = None if reader.ours else reader.profile
    count = pending = 0
    attached = config_of(reader.metadata.get(METADATA_SESSION, {})).car.files() if reader.ours else {}
    options: Any = {"further": further, "foreign": foreign, "attached": attached}
    begun = dict(reader.metadata)
    """what stands before the messages, and tells how to read them"""
    ahead = {name: metadata(name, values) for name, values in begun.items()}
    with output_file(target, source) as path, SessionFile(path, ahead, **options) as file:
        for item in chain((first,), items):
            file.open(item.stream)
            file.add(item.topic, data(item), item.log_ns, item.publish_ns, item.sequence)
            for topic, made in make(item):
                file.add(topic, made, item.log_ns, item.publish_ns, item.sequence)
            count, pending = count + 1, pending + len(item.data)
            if pending > PENDING_LIMIT:
                file.flush()
                pending = 0
        for name, values in reader.metadata.items():
            if begun.get(name) != values:
                file.add_metadata(name, metadata(name, values))
    return Recovered(count, tuple(map(str, reader.damage)))
