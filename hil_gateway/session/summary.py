"""What happened in a session: laps, stops, alerts, model revisions, effects."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil_gateway.config import Config
from hil_gateway.session.format import METADATA_SESSION
from hil_gateway.session.reader import SessionReader

NO_TOPIC = frozenset[str]()


def recorded_config(path: Path) -> Config:
    """The configuration a session was recorded with; the default one where it holds none this version can read.

    Raises:
        InputError: no readable recording.
    """
    reader = SessionReader(path, NO_TOPIC)
    next(reader.items(), None)
    return config_of(reader.metadata.get(METADATA_SESSION, {}))


def config_of(metadata: dict[str, Any]) -> Config:
    """The configuration in a session's metadata, or the default one."""
    try:
        return Config.model_validate(json.loads(metadata.get("config", "{}")))
    except (ValueError, ValidationError):
        return Config()
