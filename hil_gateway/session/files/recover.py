"""Makes a complete file of whatever a damaged one still holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.files.writer import FLUSH_EVERY, SessionFile

Make = Callable[[Item], Iterable[tuple[str, bytes]]]
"""(topic, data) of messages made of a recorded one"""


def _nothing(item: Item) -> Iterable[tuple[str, bytes]]:
    return ()


@dataclass(frozen=True)
class Recovered:
    """What became of a damaged file."""

    messages: int
    left_out: Counter[str]
    """messages of topics this version does not record, by topic"""
    damage: tuple[str, ...]


def recover(
    source: Path, target: Path, further: Mapping[str, tuple[str, bytes]] | None = None, make: Make = _nothing
) -> Recovered:
    """Copy every readable message of `source` to `target`, with what `make` makes of each on the topics `further`.

    Raises:
        InputError: `source` is no recording, or `target` cannot be written.
    """
    reader = SessionReader(source)
    count, left_out = 0, Counter[str]()
    with output_file(target, source) as path, SessionFile(path, {}, further=further) as file:
        for item in reader.items():
            if not file.knows(item.topic):
                left_out[item.topic] += 1
                continue
            file.add(item.topic, item.data, item.log_ns, item.publish_ns, item.sequence)
            for topic, data in make(item):
                file.add(topic, data, item.log_ns, item.publish_ns, item.sequence)
            count += 1
            if count % FLUSH_EVERY == 0:
                file.flush()
        for name, values in reader.metadata.items():
            file.add_metadata(name, values)
    return Recovered(count, left_out, tuple(map(str, reader.damage)))
