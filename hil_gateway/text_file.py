"""Text files that a user gives: bounded in size, never waited for, with or without the mark that Windows puts first."""

from __future__ import annotations

import codecs
import json
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError

BYTES_MAX = 20_000_000
"""of a file: a hundred times the largest of the project"""
KEY_PARTS_MAX = 20
"""of a dotted key or table: `tomllib` takes time and memory by the square of it"""
_LONG_KEY = re.compile(rf"(?<![\w\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){{{KEY_PARTS_MAX}}}")


def read_text(path: Path | str, of: str = "file", bytes_max: int = BYTES_MAX) -> str:
    """All of a UTF-8 file; `of` says what it should hold ("track", "configuration").

    Raises:
        InputError: no such file, not one that ends (pipe, socket), more than `bytes_max`, or not UTF-8.
    """
    check_ends(path, of)
    try:
        with Path(path).open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(bytes_max + 1) if size <= bytes_max else b""  # more where it grows meanwhile
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(f"{path}: cannot read the {of}: {getattr(error, 'strerror', None) or error}") from None
    if max(size, len(data)) > bytes_max:
        raise InputError(f"{path}: too large: a {of} has at most {bytes_max} bytes")
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file: byte {error.start} is not UTF-8") from None


def text_of(data: bytes) -> str:
    """Text that another program wrote in the encoding of its machine: UTF-8, UTF-16 with its mark, else Windows's."""
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def check_ends(path: Path | str, of: str) -> None:
    """Refuse what is waited for or never ends; what cannot be opened at all is left to whoever opens it.

    Raises:
        InputError: a pipe, a socket or a device; the empty one would be taken for a file without settings.
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{path}: cannot read the {of}: a pipe, socket or device; write it to a file first")


def read_json(path: Path | str, of: str = "file") -> Any:
    """What a JSON file holds; a key that is there twice is refused.

    Raises:
        InputError: as `read_text`, or not JSON.
    """
    return parse_json(path, read_text(path, of))


def parse_json(path: Path | str, text: str) -> Any:
    """What JSON text from `path` holds; a key that is there twice is refused.

    Raises:
        InputError: not JSON.
    """
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None
    except ValueError as error:  # JSONDecodeError, a key twice, a whole number of thousands of digits
        raise InputError(f"{path}: not valid JSON: {_short(error)}") from None


def read_toml(path: Path | str, of: str = "file") -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        InputError: as `read_text`, or not TOML.
    """
    return parse_toml(path, read_text(path, of))


def parse_toml(path: Path | str, text: str) -> dict[str, Any]:
    """What TOML text from `path` holds.

    Raises:
        InputError: not TOML, or a key of very many parts.
    """
    if long := _LONG_KEY.search(text):
        where = f"{path}:{text.count(chr(10), 0, long.start()) + 1}"
        raise InputError(f"{where}: nested too deeply: a key has at most {KEY_PARTS_MAX} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, a whole number of thousands of digits
        raise InputError(f"{path}: not valid TOML: {_short(error)}") from None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    tree = dict(pairs)
    if len(tree) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"key {next(name for name in tree if names.count(name) > 1)!r} is there twice")
    return tree


def _short(error: ValueError) -> str:
    return str(error).partition(";")[0][:200]
