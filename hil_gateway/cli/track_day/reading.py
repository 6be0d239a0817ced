"""Recordings read side by side with a bar: by processes of this computer, or on a Dask cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError
from hil_gateway.session.day.index import Read, read_in_turn, read_session

FEW = 2
"""sessions that are read before a process more would have started"""


def side_by_side(scheduler: str = "") -> Read:
    """Reads on all processors here, or on the cluster of this scheduler, whose workers see the same folders.

    Raises:
        InputError: a cluster is asked for and dask is missing.
    """
    if scheduler and find_spec("distributed") is None:
        raise InputError("--scheduler needs dask: pip install 'hil-gateway[cluster]'")

    def read(sessions: Sequence[tuple[Path, ...]]) -> Iterator[dict[str, Any]]:
        if not sessions:
            return
        if len(sessions) <= FEW and not scheduler:
            yield from _with_bar(read_in_turn(sessions), len(sessions))
            return
        with _executor(scheduler) as executor:
            yield from _with_bar(executor.map(read_session, sessions), len(sessions))

    return read


def _executor(scheduler: str) -> AbstractContextManager[Any]:
    from hil_gateway.process.children import pool

    if not scheduler:
        return pool(os.cpu_count() or 1)
    from distributed import Client

    executor: AbstractContextManager[Any] = Client(scheduler).get_executor()
    return executor


def _with_bar(results: Iterable[dict[str, Any]], total: int) -> Iterator[dict[str, Any]]:
    from rich.console import Console
    from rich.progress import track

    yield from track(results, "reading recordings", total, console=Console(file=sys.stderr))
