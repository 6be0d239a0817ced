"""The predictor over windows as one small C library: several times faster than numpy on matrices of three rows.

It is compiled once and kept (`hil_gateway.process.compiled`). Without a compiler, and for fewer windows than one vector
holds, the callers' numpy code does the same.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import compile_source, find_compiler

SOURCE = Path(__file__).with_name("windows.c")
VECTOR = 8
"""Windows that the library works on at once."""


class WindowsLibrary:
    """The library's functions, called with contiguous arrays and numbers."""

    def __init__(self, path: Path) -> None:
        """Load the library."""
        self._library = ctypes.CDLL(str(path))

    def call(self, name: str, *arguments: int | NDArray[Any]) -> None:
        """Call a function: numbers are sizes, arrays are float64 unless they are indices.

        Raises:
            MemoryError: the function found no working memory.
        """
        function = getattr(self._library, name)
        assert all(isinstance(a, int) or a.flags.c_contiguous for a in arguments), name
        passed = [ctypes.c_ssize_t(a) if isinstance(a, int) else ctypes.c_void_p(a.ctypes.data) for a in arguments]
        if not function(*passed):
            raise MemoryError(f"no working memory for {name} of the predictor")


@cache
def windows_library() -> WindowsLibrary | None:
    """The library; None without a compiler."""
    if find_compiler() is None:
        return None
    path = compile_source(SOURCE.read_text())
    return None if path is None else WindowsLibrary(path)


def arrange(by: Array, columns: Array) -> None:
    """Write derivatives (k, 5, windows, blocks) to the first k of the columns (blocks, windows, 5, c)."""
    library = windows_library()
    if library is None:
        columns[..., : len(by)] = by.transpose(3, 2, 1, 0)
        return
    blocks, windows, _, width = columns.shape
    library.call("arrange", blocks, windows, len(by), width, np.ascontiguousarray(by), columns)
