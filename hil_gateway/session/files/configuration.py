"""The configuration a session was recorded with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import METADATA_SESSION
from hil_gateway.session.files.reader import SessionReader

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
        return Config.model_validate_json(reader.metadata.get(METADATA_SESSION, {}).get("config", ""))
    except ValidationError as error:
        raise InputError(f"{path}: holds no configuration of this version: {error.errors()[0]['msg']}") from None


def config_of(metadata: dict[str, Any]) -> Config:
    """The configuration in a session's metadata, or the default one."""
    try:
        return Config.model_validate(json.loads(metadata.get("config", "{}")))
    except (ValueError, InputError):
        return Config()
