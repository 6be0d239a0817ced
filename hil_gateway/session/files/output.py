"""Files made of recordings: written aside and renamed, so that a command leaves a whole file or none."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hil_gateway.process.errors import InputError
from hil_gateway.process.writable import check_file


@contextmanager
def output_file(target: Path, source: Path) -> Iterator[Path]:
    """Path to write to: it becomes `target` when the block ends well, and is gone when it does not.

    A device or a pipe (/dev/stdout) is written to directly.

    Raises:
        InputError: `target` is `source` under any name, a folder, not writable, or its disk is full.
    """
    check_file(target, (source,))
    try:
        if Path("/dev") in target.parents or (target.exists() and not target.is_file()):
            target.open("ab").close()  # a folder ends here
            yield target
            return
        with _aside(target.resolve()) as path:  # what a link points to is replaced, not the link
            yield path
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{target}: cannot write: {reason}; choose another --out") from None


@contextmanager
def _aside(final: Path) -> Iterator[Path]:
    final.parent.mkdir(parents=True, exist_ok=True)
    path = final.with_name(f".{final.name}.{os.getpid()}")
    path.unlink(missing_ok=True)
    try:
        yield path
        path.replace(final)
    finally:
        path.unlink(missing_ok=True)


def output_path(source: Path, ending: str) -> Path:
    """Where the output goes when nobody says: next to `source`, with another ending.

    Raises:
        InputError: `source` has no name, as `.` or `/`.
    """
    if not source.name:
        raise InputError(f"{source}: not a file")
    return source.with_name(source.stem + ending)
