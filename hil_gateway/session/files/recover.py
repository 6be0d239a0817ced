"""Makes a complete file of whatever a damaged one still holds."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import FLUSH_EVERY, SessionFile


@dataclass(frozen=True)
class Recovered:
    """What became of a damaged file."""

    messages: int
    left_out: Counter[str]
    """messages of topics this version does not record, by topic"""
    damage: tuple[str, ...]


def recover(source: Path, target: Path) -> Recovered:
    """Copy every readable message of `source` to `target`.

    Raises:
        InputError: `source` is no recording, or `target` cannot be written.
    """
    reader = SessionReader(source)
    count, left_out = 0, Counter[str]()
    with output_file(target, source) as path, SessionFile(path, {}) as file:
        for item in reader.items():
            if not file.knows(item.topic):
                left_out[item.topic] += 1
                continue
            file.add(item.topic, item.data, item.log_ns, item.publish_ns, item.sequence)
            count += 1
            if count % FLUSH_EVERY == 0:
                file.flush()
        for name, values in reader.metadata.items():
            file.add_metadata(name, values)
    return Recovered(count, left_out, tuple(map(str, reader.damage)))
