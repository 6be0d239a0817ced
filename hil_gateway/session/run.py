"""One run in several files: a recorder that is started again begins a new one while the gateway goes on.

Two files belong together when the gateway of the later one already ran when the earlier one began: its status carries a
number that advances ten times a second from 0 on. Files that one recorder wrote in parts belong together as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.bus.messages import GatewayStatus
from hil_gateway.bus.topics import GATEWAY_STATUS
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import METADATA_SESSION, MessageError, unpack_message
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.logs.raw_bag import is_mcap, is_recording
from hil_gateway.session.logs.source import Source

LISTENED_NS = 30 * NS_PER_S
"""from the start of a file on: a gateway that was started with the recorder has spoken by then"""
LEAST_PACE = 0.8
"""of the rate of the status: a gateway on a busy computer skips some"""


@dataclass(frozen=True)
class Beginning:
    """What tells of a file whether it goes on with another one; `began_ns` is Unix time."""

    path: Path
    began_ns: int
    recorder: tuple[str, str]
    """name and start of the recorder"""
    part: int
    status: GatewayStatus | None

    def goes_on_with(self, earlier: Beginning) -> bool:
        """Whether this file and `earlier` are of one run."""
        if self.recorder == earlier.recorder and self.part > earlier.part and self.recorder[1]:
            return True
        now, then = self.status, earlier.status
        if now is None or then is None or now.stamp_ns <= then.stamp_ns:
            return False
        elapsed_s = (now.stamp_ns - then.stamp_ns) / NS_PER_S
        return now.seq - then.seq >= LEAST_PACE * GATEWAY_STATUS.rate_hz * elapsed_s


def beginning(path: Path) -> Beginning:
    """Read as much of a file as that needs.

    Raises:
        InputError: no readable recording.
    """
    reader, began_ns, status = SessionReader(path), 0, None
    for item in reader.items():
        began_ns = began_ns or item.log_ns
        status = _status(item) if item.topic == GATEWAY_STATUS.key else None
        if status or item.log_ns > began_ns + LISTENED_NS:
            break
    session = reader.metadata.get(METADATA_SESSION, {})
    part = session.get("part", "")
    recorder = session.get("name", ""), session.get("started", "")
    return Beginning(path, began_ns, recorder, int(part) if part.isdecimal() else 0, status)


def _status(item: Item) -> GatewayStatus | None:
    try:
        return unpack_message(GATEWAY_STATUS, item.data)
    except MessageError:  # of another version: said by whoever reads the file
        return None


def runs_in(paths: Sequence[Path]) -> list[tuple[Path, ...]]:
    """Files grouped into runs, both in order of time; one that cannot be read is a run of its own, at the end."""
    read, unreadable = [], []
    for path in paths:
        try:
            read.append(beginning(path))
        except InputError:
            unreadable.append((path,))
    runs: list[list[Beginning]] = []
    for file in sorted(read, key=lambda file: (file.began_ns, file.part, file.path.name)):
        for run in runs:
            if file.goes_on_with(run[0]):
                run.append(file)
                break
        else:
            runs.append([file])
    return [tuple(file.path for file in run) for run in runs] + unreadable


def recordings(folder: Path) -> list[Path]:
    """The recordings that lie in a folder."""
    return sorted(path for path in folder.glob("*.mcap") if path.is_file())


def newest_in(folder: Path) -> Path:
    """The recording that was written last, of those in a folder and in the folders in it.

    Raises:
        InputError: there is none.
    """
    found = [path for place in (folder, *filter(Path.is_dir, folder.iterdir())) for path in recordings(place)]
    if not found:
        raise InputError(f"{folder}: no recording (.mcap) in it or in the folders in it")
    return max(found, key=lambda path: path.stat().st_mtime_ns)


def runs_below(folder: Path) -> Iterator[tuple[Path, ...]]:
    """Every run in a folder and below it, as the parts of its recording; files of other programs are left out."""
    for place in sorted({path.parent for path in folder.rglob("*.mcap") if path.is_file()}):
        yield from runs_in([file for file in recordings(place) if not _foreign(file)])


def _foreign(file: Path) -> bool:
    """Whether it is a whole file of another program, as an export."""
    return is_mcap(Source(file)) and not is_recording(Source(file))


def run_of(path: Path) -> tuple[Path, ...]:
    """A recording and those beside it that go on with it."""
    for run in runs_in(recordings(path.parent)):
        if path in run:
            return run[run.index(path) :]
    return (path,)
