"""A small C library, compiled once and kept, and called with numpy arrays."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from hil_gateway.process.compiled import compile_source, find_compiler


class Library:
    """Functions of C that return whether they found the working memory they need."""

    def __init__(self, path: Path) -> None:
        """Load the library."""
        self._library = ctypes.CDLL(str(path))

    def call(self, name: str, *arguments: int | NDArray[Any]) -> None:
        """Call a function with numbers, which are sizes, and contiguous arrays.

        Raises:
            MemoryError: the function found no working memory.
        """
        assert all(isinstance(a, int) or a.flags.c_contiguous for a in arguments), name
        passed = [ctypes.c_ssize_t(a) if isinstance(a, int) else ctypes.c_void_p(a.ctypes.data) for a in arguments]
        if not getattr(self._library, name)(*passed):
            raise MemoryError(f"no working memory for {name} in C")


def load_library(source: Path, definitions: str = "") -> Library | None:
    """The library of a C file behind some `definitions`; None without a compiler."""
    if find_compiler() is None:
        return None
    path = compile_source(definitions + source.read_text())
    return None if path is None else Library(path)
