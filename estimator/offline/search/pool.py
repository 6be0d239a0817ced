"""Processes that fits are done in: started once, and each record is handed to them once.

A record of a quarter of an hour is 20 MB: sent along with every fit it would take longer than many a fit.
"""

from __future__ import annotations

import copyreg
import ctypes
import io
import pickle
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from estimator.offline.record.record import Record
from hil_gateway.process.children import begin, pool

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""names of <malloc.h>"""
KEPT_BYTES, LARGEST_BYTES = 1 << 30, 32 << 20
RECORDS = 6
"""Records that are kept for the processes, and by each of them: those of one round of a search, on all windows and on
part of them, with the empirical terms that are tried."""

TASKS = "estimator.offline.search.workers"
"""module of the tasks: with it, what they need is imported before the first comes"""


class Pool:
    """An executor whose tasks get records as names of files, written when they are first sent.

    It serves one thread.
    """

    def __init__(self, executor: Executor, folder: Path) -> None:
        """`folder` holds the records."""
        self._executor, self._folder = executor, folder
        self._stored: dict[Path, Record] = {}
        self._written = 0
        self._sent: list[Future[Any]] = []

    def submit(self, task: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Do `task`, a function of a module, in one of the processes."""
        packed = io.BytesIO()
        _Pickler(packed, self._path_of).dump(arguments)
        future = self._executor.submit(_do, task, packed.getvalue())
        self._sent = [*(one for one in self._sent if not one.done()), future]
        return future

    def forget_old(self) -> None:
        """Delete all but the newest records, unless a task that may read one is not done."""
        if not all(future.done() for future in self._sent):
            return
        for path in list(self._stored)[:-RECORDS]:
            del self._stored[path]
            path.unlink()

    def _path_of(self, record: Record) -> str:
        known = next((path for path, stored in self._stored.items() if stored is record), None)
        if known is None:
            known = self._folder / f"{self._written}.record"
            self._written += 1
            known.write_bytes(pickle.dumps(record, pickle.HIGHEST_PROTOCOL))
            self._stored[known] = record
        return str(known)


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, path_of: Callable[[Record], str]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.dispatch_table = {**copyreg.dispatch_table, Record: lambda record: (_read, (path_of(record),))}


@lru_cache(RECORDS)
def _read(path: str) -> Record:
    record = pickle.loads(Path(path).read_bytes())
    assert isinstance(record, Record)
    return record


def _do(task: Callable[..., Any], packed: bytes) -> Any:
    return task(*pickle.loads(packed))


@contextmanager
def workers(count: int) -> Iterator[Pool | None]:
    """So many processes for fits, which begin to start at once; none for a count of 1."""
    if count <= 1:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="hil-records-") as folder, pool(count, _begin) as executor:
        for _ in range(count):
            executor.submit(import_module, TASKS)
        yield Pool(executor, Path(folder))


def _begin() -> None:
    begin()
    keep_freed_memory()


def keep_freed_memory() -> None:
    """Have the C library keep what is freed: arrays of megabytes come and go, and fetching their pages anew from the
    kernel each time took a sixth of all time. Other C libraries than GNU's have no such setting."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        library.mallopt(M_MMAP_THRESHOLD, LARGEST_BYTES)
