"""What several tests of a run share and takes long to make: made once, by whichever process asks first."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[], T]) -> T:
    """What `make` returns, kept in a file of this run of the tests; other processes that ask wait for it.

    `HIL_MADE_ONCE` names a folder in which an earlier process of the run may have made it.
    """
    own = factory.getbasetemp()
    folder = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    return kept(Path(os.environ.get("HIL_MADE_ONCE", folder)), name, make)


def kept(folder: Path, name: str, make: Callable[[], T]) -> T:
    """What `make` returns, from the file in `folder` if it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.pickle"
    with (folder / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            path.write_bytes(pickle.dumps(make()))
    return pickle.loads(path.read_bytes())  # type: ignore[no-any-return]  # what this run has written
