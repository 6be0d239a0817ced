"""A run as it is planned (`run.toml`), what a person asks of it, and where in it the car is."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from hil_gateway.bus.messages import Count, Message, Name, Text
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model
from hil_gateway.text_file import read_toml

MOST_METRES = 1e6
"""along a track: no circuit is as long"""
Speed = Annotated[float, Field(ge=5, le=100)]
"""m/s; a slower cap is no lap but walking"""
LoadUse = Annotated[float, Field(ge=0.2, le=1)]
"""share of the grip that the car is believed to have; with less it does not come up a hill"""


class RunPlan(Model):
    """What a run is to be. Caps lap by lap after the out lap; the last one holds for those that follow."""

    name: Name = "run"
    laps: int = Field(default=1, ge=1, le=500, description="flying laps, between out lap and in lap")
    out_lap: bool = Field(default=True, description="the lap that begins where the car stands is not counted")
    speed: Annotated[tuple[Speed, ...], Field(max_length=500)] = Field(
        default=(), description="caps, m/s; none: that of a car and a model that have driven as far as these have"
    )
    load_use: Annotated[tuple[LoadUse, ...], Field(max_length=500)] = Field(default=(), description="caps, as `speed`")
    stop_at: float | None = Field(
        default=None,
        ge=0,
        le=MOST_METRES,
        description="where the in lap ends on the road, m along the track",
    )
    box: int | None = Field(
        default=None,
        ge=1,
        le=100,
        description="of the pit lane where the in lap ends; neither given: the first, without one 30 m before the line",
    )
    tyres: Name = Field(default="", description="name of the tyre set")
    tyre_c_max: float | None = Field(
        default=None, ge=0, le=300, description="of the hottest point of a tyre, deg C; hotter, the car comes in"
    )
    fuel_kg: float | None = Field(default=None, ge=0, le=500)
    fuel_per_km: float | None = Field(
        default=None, gt=0, le=5, description="kg; the car comes in while `fuel_kg` still lasts for two laps"
    )
    notes: Text = ""

    @model_validator(mode="after")
    def _knows_its_fuel(self) -> Self:
        if self.fuel_per_km is not None and self.fuel_kg is None:
            raise ValueError("fuel_per_km says nothing without fuel_kg")
        return self


def read_run(path: Path) -> RunPlan:
    """A run from a TOML file.

    Raises:
        InputError: unreadable, an unknown key, a value out of range.
    """
    try:
        return RunPlan.model_validate(read_toml(path, "run"))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        if first["type"] == "extra_forbidden":
            raise InputError(f"{path}: unknown key {key}; known: {', '.join(RunPlan.model_fields)}") from None
        given = f"{key} = {first['input']!r}: " if key else ""
        raise InputError(f"{path}: {given}{first['msg'].lower()}") from None


def cap_of(caps: Sequence[float], lap: int, otherwise: float) -> float:
    """Cap of flying lap number `lap`, from 0 on."""
    return caps[min(lap, len(caps) - 1)] if caps else otherwise


class RunAction(StrEnum):
    """What a person asks for."""

    START = "start"
    """this plan, from where the car stands"""
    NEXT = "next"
    """the last plan again, with caps that have risen if its run was clean"""
    IN = "in"
    """the lap under way becomes the in lap"""
    ABORT = "abort"
    """brake and stop here"""


class RunRequest(Message):
    """A person's request; a second delivery of one is known by source and number."""

    source: Name
    action: RunAction
    plan: RunPlan | None = None


class RunPhase(StrEnum):
    """Where in the run the car is."""

    STARTING = "starting"
    """the planner is there, and compiles what it plans with"""
    NONE = "none"
    """nobody has started one: no caps"""
    OUT_LAP = "out lap"
    FLYING = "flying"
    IN_LAP = "in lap"
    DONE = "done"
    """stopped where the in lap ends, or aborted"""


UNDER_WAY = (RunPhase.OUT_LAP, RunPhase.FLYING, RunPhase.IN_LAP)
"""phases in which a run is driven"""


class RunStatus(Message):
    """Where in which run the car is, and what holds there (5 Hz)."""

    phase: RunPhase
    number: Count = Field(description="of runs since the planner began")
    plan: RunPlan | None = None
    lap: Count = Field(default=0, description="flying lap under way, from 1 on")
    speed_cap: float | None = Field(default=None, ge=0, le=100, description="m/s; null: none")
    load_cap: float | None = Field(default=None, ge=0, le=1, description="share of the grip; null: none")
    caps_from: Text = Field(default="", description="why these caps")
    stop_at: float | None = Field(
        default=None, ge=0, le=MOST_METRES, description="where the in lap ends, m along the track"
    )
    box: Count | None = Field(default=None, description="in which the in lap ends; null: on the road")
    in_pit_lane: bool = Field(default=False, description="whether the car is where only the pit lane is")
    clean: bool | None = Field(default=None, description="of a run that is done: whether caps may rise")
    said: Text = Field(default="", description="why the run is where it is")
    answered: Name = Field(default="", description="source of the last request")
    refused: Text = Field(default="", description="why that request came to nothing")

    @property
    def caps(self) -> str:
        """What holds, in words; empty where nothing does."""
        speed = [] if self.speed_cap is None else [f"{self.speed_cap:g} m/s"]
        load = [] if self.load_cap is None else [f"{100 * self.load_cap:.0f} % of the grip"]
        return ", ".join(speed + load)
