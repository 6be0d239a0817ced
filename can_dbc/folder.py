"""Files of a car folder: found by name or path, bounded in size, and checked with one clear line for each mistake."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from can_dbc.errors import PlatformError

SHIPPED = Path(__file__).parent
"""where the cars lie that come with the project"""
DEFAULT_PLATFORM = "av24"
FILE_BYTES_MAX = 4_000_000
"""of one file of a car folder: ten times the DBC of a road car"""
FILES = ("bus.toml", "signals.toml", "car.toml")
"""beside the one DBC"""


class FileModel(BaseModel):
    """What a TOML file holds: frozen, strict about names, finite numbers only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


M = TypeVar("M", bound=BaseModel)


def platforms() -> list[str]:
    """Names of the cars that come with the project."""
    return sorted(path.parent.name for path in SHIPPED.glob("*/car.toml"))


def platform_folder(platform: str) -> Path:
    """Folder of a car that is given by the name of a shipped one or by a path.

    Raises:
        PlatformError: neither.
    """
    if platform in platforms():
        return SHIPPED / platform
    folder = Path(platform)
    if not folder.is_dir():
        raise PlatformError(f"{platform}: no such car: neither a folder nor one of {', '.join(platforms())}")
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        raise PlatformError(f"{folder / missing[0]}: missing; a car folder holds one DBC and {', '.join(FILES)}")
    return folder


def dbc_path(folder: Path) -> Path:
    """The one DBC of a car folder.

    Raises:
        PlatformError: none, or several.
    """
    found = sorted(folder.glob("*.dbc"))
    if len(found) != 1:
        raise PlatformError(f"{folder}: holds {len(found)} files that end in .dbc, a car folder holds one")
    return found[0]


def read_text(path: Path) -> str:
    """All of a UTF-8 file.

    Raises:
        PlatformError: unreadable, too large, or not UTF-8.
    """
    try:
        if not path.is_file():
            raise PlatformError(f"{path}: no such file")
        with path.open("rb") as file:
            data = file.read(FILE_BYTES_MAX + 1)
        if len(data) > FILE_BYTES_MAX:
            raise PlatformError(f"{path}: more than {FILE_BYTES_MAX} bytes: no file of a car folder is so large")
        return data.decode("utf-8-sig")
    except OSError as error:
        raise PlatformError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise PlatformError(f"{path}: not a text file: byte {error.start} is not UTF-8; save it as UTF-8") from None


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        PlatformError: as `read_text`, or not TOML.
    """
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise PlatformError(f"{path}: nested too deeply") from None
    except ValueError as error:
        raise PlatformError(f"{path}: not valid TOML: {str(error)[:200]}") from None


def checked(model: type[M], tree: Any, path: Path, prefix: str = "") -> M:
    """`tree` as a `model`; `prefix` is where in the file it stands.

    Raises:
        PlatformError: names file, key, value and what is allowed.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise PlatformError(f"{path}: {_explain(error, model, prefix)}") from None


def _explain(error: ValidationError, model: type[BaseModel], prefix: str) -> str:
    first = error.errors()[0]
    key = ".".join(filter(None, (prefix, *(str(part) for part in first["loc"]))))
    match first["type"]:
        case "value_error":
            return f"{key + ': ' if key else ''}{first['ctx']['error']}"
        case "missing":
            return f"{key} is missing"
        case "model_type" if not first["loc"]:
            fields = ", ".join(f"{name} = ..." for name in model.model_fields)
            return f"{key} = {first['input']!r}: it is written as {{ {fields} }}"
        case "extra_forbidden":
            known = ", ".join(model.model_fields) if len(first["loc"]) == 1 else ""
            return f"unknown key {key}" + (f"; known are {known}" if known else "")
    value = repr(first["input"])
    return f"{key} = {value if len(value) < 100 else value[:97] + '...'}: {first['msg'].lower()}"
