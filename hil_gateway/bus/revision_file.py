"""A model revision as a file (`model.json`)."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from hil_gateway.bus.messages import ModelRevision
from hil_gateway.process.errors import InputError
from hil_gateway.text_file import read_text


def read_revision(path: str | Path) -> ModelRevision:
    """The revision in a file.

    Raises:
        InputError: unreadable, or not a revision.
    """
    try:
        return ModelRevision.model_validate_json(read_text(path, "model revision"))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "file"
        raise InputError(f"{path}: not a model revision: {place}: {first['msg']}") from None
