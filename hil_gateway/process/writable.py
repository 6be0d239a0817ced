"""May a command write where it was told to? Asked before any work; nothing is made or changed by asking.

The answer comes from the file system itself (an unnamed file is opened and closed in the place), because permission
bits say nothing of /proc, of a disk mounted read-only, or of what the superuser may not do either.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hil_gateway.process.errors import InputError

NAME_MAX, PATH_MAX = (os.pathconf("/", limit) for limit in ("PC_NAME_MAX", "PC_PATH_MAX"))
"""bytes of one name, and of a whole path with its closing zero"""
RECORDING = ".mcap"
"""ending of recorded drives, which cannot be made again"""
ASIDE = 12
"""bytes a name grows by while its file is written aside: two dots and a process identifier"""
INSIDE = 80
"""bytes left for what goes into a folder: the longest of ours, with two folders around it, has 50"""


def check_file(path: Path, reads: Sequence[Path] = (), option: str = "--out") -> None:
    """Refuse a file that cannot be written, that is one of `reads`, or a recording that is there already.

    Raises:
        InputError: naming `path`, the reason and `option`.
    """
    try:
        _check_text(path, option, longer=ASIDE)
        if any(_same(path, other) for other in reads):
            raise InputError(f"{path}: never written over, it is what is read; choose another {option}")
        if path.is_dir():
            raise InputError(f"{path}: is a folder, a file is needed; choose another {option}")
        if path.suffix == RECORDING and path.is_file():
            raise InputError(f"{path}: there already, a recording is never written over; choose another {option}")
        if path.exists() and not os.access(path, os.W_OK):
            raise InputError(f"{path}: cannot write: Permission denied; choose another {option}")
        if path.is_file() or not path.exists():
            _probe(Path(os.path.realpath(path)).parent)
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror}; choose another {option}") from None


def check_folder(path: Path, names: Sequence[str] = (), reads: Sequence[Path] = (), option: str = "--out") -> None:
    """Refuse a folder that cannot be made or written in, or in which one of `names` may not be written.

    Args:
        path: of the folder, which need not exist.
        names: of the files the command will leave in it.
        reads: files the command reads, which it must not write over.
        option: what a user has to change.

    Raises:
        InputError: naming the place, the reason and `option`.
    """
    try:
        _check_text(path, option, deeper=INSIDE)
        _probe(path)
    except OSError as error:
        raise InputError(f"{path}: cannot write there: {error.strerror}; choose another {option}") from None
    for name in names:
        check_file(path / name, reads, option)


def free_bytes(path: Path) -> int:
    """Free space on the disk that `path` is on or will be on.

    Raises:
        OSError: it cannot be read.
    """
    return shutil.disk_usage(_existing(path)).free


def short_of_space(free: int, least: int) -> str:
    """Why nothing is recorded: `free` and `least` in bytes."""
    return f"{free / 1e6:.0f} MB free on this disk, below the {least / 1e6:.0f} MB of recorder.min_free_bytes"


def _check_text(path: Path, option: str, longer: int = 0, deeper: int = 0) -> None:
    """Refuse names no file system, terminal or configuration file takes."""
    text = str(path)
    if any(ord(character) < 32 or ord(character) == 127 for character in text):
        raise InputError(f"{text!r}: a name with control characters; choose another {option}")
    try:
        parts = path.absolute().parts
        sizes = [len(part.encode()) for part in parts]
    except UnicodeEncodeError:
        raise InputError(f"{text!r}: a name that is not UTF-8 text; choose another {option}") from None
    sizes[-1] += longer
    if max(sizes) > NAME_MAX:
        longest = max(parts, key=len)
        limit = f"{len(longest.encode())} bytes is too long (limit {NAME_MAX - longer})"
        raise InputError(f"{longest[:40]}...: a name of {limit}; choose a shorter {option}")
    if sum(sizes) + len(sizes) + deeper > PATH_MAX:
        room = PATH_MAX - deeper
        raise InputError(f"{text[:40]}...: the path is too long (limit {room} bytes); choose a shorter {option}")


def _same(path: Path, other: Path) -> bool:
    return path.exists() and other.exists() and path.samefile(other)


def _existing(path: Path) -> Path:
    """The nearest folder (or what is in the place of one) that is there already."""
    absolute = path.absolute()
    return next(p for p in (absolute, *absolute.parents) if os.path.lexists(p))


def _probe(folder: Path) -> None:
    """Open and close a file without a name in the nearest folder that exists.

    Raises:
        OSError: nothing can be written there.
    """
    place = _existing(folder)
    if not place.is_dir():
        raise NotADirectoryError(0, f"{place} is no folder")
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise OSError(error.errno, f"nothing can be written in {place} ({error.strerror})") from None
