"""Makes a complete file of whatever a damaged one still holds."""

from __future__ import annotations

from pathlib import Path

from hil_gateway.errors import InputError
from hil_gateway.session.reader import SessionReader
from hil_gateway.session.writer import SessionFile

FLUSH_EVERY = 5000
"""messages in a chunk"""


def recover(source: Path, target: Path) -> tuple[int, SessionReader]:
    """Copy every readable message of `source` to `target`; returns their number and the reader with the damage.

    Raises:
        InputError: `source` is no recording, or `target` cannot be written.
    """
    if target.resolve() == source.resolve():
        raise InputError(f"{target}: recovery never writes over its source; choose another --out")
    reader = SessionReader(source)
    count = 0
    with open_output(target, {}) as file:
        for item in reader.items():
            if not file.knows(item.topic):
                continue
            file.add(item.topic, item.data, item.log_ns, item.publish_ns, item.sequence)
            count += 1
            if count % FLUSH_EVERY == 0:
                file.flush()
        for name, values in reader.metadata.items():
            file.add_metadata(name, values)
    return count, reader


def open_output(target: Path, metadata: dict[str, dict[str, str]]) -> SessionFile:
    """A new session file.

    Raises:
        InputError: it cannot be made there.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        return SessionFile(target, metadata)
    except OSError as error:
        raise InputError(f"{target}: cannot write: {error.strerror}") from None
