"""The configuration a session was recorded with."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from pydantic import ValidationError

from can_dbc.folder import DEFAULT_PLATFORM
from hil_gateway.car.car import PLATFORM_VARIABLE, Car, default_platform, load_car
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import METADATA_SESSION
from hil_gateway.session.files.reader import MAGIC, SessionReader

NO_TOPIC = frozenset[str]()


def recorded_config(path: Path) -> Config:
    """The configuration a session was recorded with; the default one where it holds none this version can read.

    Raises:
        InputError: no readable recording.
    """
    reader = SessionReader(path, NO_TOPIC)
    next(reader.items(), None)
    return config_of(reader.metadata.get(METADATA_SESSION, {}))


def required_config(path: Path) -> Config:
    """The same where nothing else will do.

    Raises:
        InputError: no readable recording, or none that this version understands.
    """
    reader = SessionReader(path, NO_TOPIC)
    for _ in reader.items():
        pass
    try:
        return _validated(reader.metadata.get(METADATA_SESSION, {}))
    except ValidationError as error:
        raise InputError(f"{path}: holds no configuration of this version: {error.errors()[0]['msg']}") from None


def config_of(metadata: Mapping[str, str]) -> Config:
    """The configuration in a session's metadata, or the default one of its car.

    Raises:
        InputError: its car is not here.
    """
    try:
        return _validated(metadata)
    except ValueError:
        return Config()


def _validated(metadata: Mapping[str, str]) -> Config:
    """Of the car that `--platform` names, or else of the one that was recorded."""
    tree = json.loads(metadata.get("config", "{}"))
    recorded = tree.get("platform", DEFAULT_PLATFORM) if isinstance(tree, dict) else DEFAULT_PLATFORM
    if PLATFORM_VARIABLE in os.environ:
        return Config.model_validate({**tree, "platform": default_platform()})
    try:
        return Config.model_validate({**tree, "platform": recorded})
    except InputError as error:
        raise InputError(f"recorded with the car {recorded}: {error}; name its folder with --platform") from None


def recorded_car(paths: Iterable[Path]) -> Car:
    """The car that `--platform` names, or else that of the recordings among `paths`.

    Raises:
        InputError: recordings of two cars, or of one that is not here.
    """
    cars = {config.platform: path for path in paths if (config := _config_if_ours(path)) is not None}
    if len(cars) > 1:
        (one, first), (other, second), *_ = cars.items()
        raise InputError(f"{first} is of the car {one}, {second} of {other}: give those of one car")
    return load_car(*cars)


def _config_if_ours(path: Path) -> Config | None:
    """None of a file of another program."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return None
    reader = SessionReader(path, NO_TOPIC)
    next(reader.items(), None)
    return config_of(reader.metadata.get(METADATA_SESSION, {})) if reader.ours else None
