"""The folder of a drive: never emptied, written by one demo at a time, never over what it did not make.

A marker file says that a demo made what lies here, and its lock that one is writing now. What an earlier drive left
moves, whole, into a folder of its own: `earlier-1` is the first drive, `earlier-2` the second.
"""

from __future__ import annotations

import datetime as dt
import fcntl
import json
import os
import re
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import IO

from hil_gateway.process.errors import InputError
from hil_gateway.process.writable import check_folder, free_bytes, short_of_space

CONFIG_NAME = "config.toml"
MARKER = ".hil-demo"
EARLIER = "earlier"
MADE = re.compile(r"config\.toml|session(_\d{3})?\.mcap|logs|declared\.json|diagnosis|after")
"""names a drive may leave in its folder"""


class FolderLock:
    """Held while a demo writes into a folder; the kernel lets go of it when the process ends in any way."""

    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Let others write; twice is harmless."""
        self._file.close()


def check_drive_folder(folder: Path, inputs: Sequence[Path], least_free_bytes: int) -> None:
    """Refuse a folder that a drive cannot be recorded in; nothing is made or changed.

    Args:
        folder: where the drive is to go.
        inputs: files the demo was given, which must not be written over or moved.
        least_free_bytes: free space below which the recorder does not record.

    Raises:
        InputError: not writable, foreign files in the way, another demo at work, an input inside, disk too full.
    """
    check_folder(folder)
    in_the_way = list(_made(folder))
    for path in in_the_way:
        if any(_within(given, path) for given in inputs):
            raise InputError(f"{path}: was given to the demo and would give way to the new drive; choose another --out")
    if in_the_way and not (folder / MARKER).is_file():
        raise InputError(f"{in_the_way[0]}: not made by a demo here, left as it is; choose another --out")
    if (folder / MARKER).exists():
        _lock(folder, "r").close()
    if (free := free_bytes(folder)) < least_free_bytes:
        reason = short_of_space(free, least_free_bytes)
        raise InputError(f"{folder}: no drive would be recorded: {reason}; free some or choose another --out")


def claim(folder: Path) -> FolderLock:
    """Make the folder, lock it, and put aside what an earlier drive left there.

    Raises:
        InputError: another demo was faster, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = _lock(folder, "a+")
        _sign(file)
        _put_aside(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot write there: {error.strerror}; choose another --out") from None
    return FolderLock(file)


def hold(folder: Path) -> FolderLock:
    """Lock the folder of a drive that has ended, for what is made of it.

    Raises:
        InputError: another demo writes there now.
    """
    return FolderLock(_lock(folder, "a+"))


def _made(folder: Path) -> Iterator[Path]:
    """What is there under the names of a drive."""
    if folder.is_dir():
        yield from (path for path in sorted(folder.iterdir()) if MADE.fullmatch(path.name))


def _within(given: Path, path: Path) -> bool:
    """Whether a file that was given is `path`, under any name, or lies in it."""
    real = Path(os.path.realpath(path))
    return Path(os.path.realpath(given)).is_relative_to(real)


def _lock(folder: Path, mode: str) -> IO[str]:
    file = (folder / MARKER).open(mode, encoding="utf-8")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        who = file.read()
        file.close()
        raise InputError(f"{folder}: a demo is writing there now{_named(who)}; choose another --out") from None
    return file


def _sign(file: IO[str]) -> None:
    """Say who holds the lock."""
    file.truncate(0)
    file.write(json.dumps({"process": os.getpid(), "since": f"{dt.datetime.now():%Y-%m-%d %H:%M:%S}"}))
    file.flush()


def _named(who: str) -> str:
    try:
        writer = json.loads(who)
        return f" (process {writer['process']} since {writer['since']})"
    except (ValueError, KeyError, TypeError):  # it has not said yet
        return ""


def _put_aside(folder: Path) -> None:
    made = list(_made(folder))
    if not made:
        return
    place = next(p for n in count(1) if not os.path.lexists(p := folder / f"{EARLIER}-{n}"))
    place.mkdir()
    for path in made:
        path.rename(place / path.name)
