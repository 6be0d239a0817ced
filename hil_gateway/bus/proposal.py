"""What the learner makes of the laps so far: a model to drive with, or why the one in force stays."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from hil_gateway.bus.messages import Code, Message, ModelRevision, Name, Stamp, Text


class Outcome(StrEnum):
    """What becomes of the model in force."""

    STARTED = "started"
    """a diagnosis has begun"""
    KEPT = "kept"
    """nothing found is better"""
    PROPOSED = "proposed"
    """another model is to be driven with"""
    CONFIRMED = "confirmed"
    """the first whole lap with it was no worse"""
    WITHDRAWN = "withdrawn"
    """the model before the last proposal is to be driven with again"""


class ModelProposal(Message):
    """Outcome of a diagnosis while driving, or of the first lap with what it found."""

    outcome: Outcome
    lap: Code = Field(description="laps done")
    effects: Annotated[tuple[Name, ...], Field(max_length=64)] = Field(
        default=(), description="what was found beyond the model in force"
    )
    reason: Text = Field(description="why, with the figures it was decided by")
    revision: ModelRevision | None = Field(default=None, description="model to drive with; null: the one in force")
    use_from_ns: Stamp = Field(
        default=0, description="stamp of the vehicle state from which on it is used, gateway clock"
    )
