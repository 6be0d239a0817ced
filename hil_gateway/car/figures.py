"""Numbers of a car file: value, unit, standard deviation and source of each, read into typed sections in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, Field

from can_dbc.errors import PlatformError
from can_dbc.folder import FileModel, checked
from can_dbc.units import UNITS


@dataclass(frozen=True)
class In:
    """Unit that a section keeps a number in."""

    unit: str


Number = Annotated[float, In("1")]
Length = Annotated[float, In("m")]
Angle = Annotated[float, In("rad")]
Seconds = Annotated[float, In("s")]
Force = Annotated[float, In("N")]
Torque = Annotated[float, In("N m")]
Rpm = Annotated[float, In("rpm")]
Pressure = Annotated[float, In("Pa")]

EXACT = "exact"
"""standard deviation of what is set or counted"""


def _percent(value: object) -> object:
    """ "10 %" -> the text itself; anything else that is text is none."""
    if isinstance(value, str) and value != EXACT:
        number, percent, rest = value.partition("%")
        if not percent or rest.strip():
            raise ValueError(f'{value!r}: a number in the unit, "10 %", or "{EXACT}"')
        if not 0 < float(number) <= 1000:
            raise ValueError(f"{value!r}: more than 0 %, at most 1000 %")
    return value


class Figure(FileModel):
    """One number, or list of numbers, as it stands in the file."""

    value: float | tuple[float, ...]
    unit: str
    std: Annotated[float | str, BeforeValidator(_percent)]
    source: Annotated[str, Field(min_length=3)]

    def std_of(self, factor: float) -> float:
        """Standard deviation in the unit of the section; 0 where it is exact. Of a list, relative to its values."""
        if self.std == EXACT:
            return 0.0
        if isinstance(self.std, str):
            share = 0.01 * float(self.std.partition("%")[0])
            return share if isinstance(self.value, tuple) else share * abs(self.value) * factor
        return self.std * factor


M = TypeVar("M", bound=BaseModel)


def read_section(model: type[M], tree: Any, path: Path, section: str) -> tuple[M, Mapping[str, Figure]]:
    """A table of figures as a section in the units of its fields, and the figures themselves in those units.

    Raises:
        PlatformError: an unknown, missing or impossible number, or one without unit, deviation or source.
    """
    if not isinstance(tree, dict):
        raise PlatformError(f"{path}: [{section}] is missing" if tree is None else f"{path}: {section} must be a table")
    figures: dict[str, Figure] = {}
    for key, given in tree.items():
        if key not in model.model_fields:
            raise PlatformError(f"{path}: unknown key {section}.{key}; known are {', '.join(model.model_fields)}")
        figures[key] = _converted(checked(Figure, given, path, f"{section}.{key}"), model, key, path, section)
    if missing := [key for key, field in model.model_fields.items() if field.is_required() and key not in figures]:
        raise PlatformError(f"{path}: {section}.{missing[0]} is missing")
    return checked(model, {key: figure.value for key, figure in figures.items()}, path, section), figures


def _converted(figure: Figure, model: type[BaseModel], key: str, path: Path, section: str) -> Figure:
    """The same in the unit of the field."""
    wanted = _unit_of(model, key)
    given = UNITS.get(figure.unit)
    if given is None or given.si != UNITS[wanted].si:
        fitting = ", ".join(unit for unit, known in UNITS.items() if known.si == UNITS[wanted].si and unit)
        raise PlatformError(f"{path}: {section}.{key}: unit {figure.unit!r}: it is given in {fitting}")
    if figure.value == 0.0 and isinstance(figure.std, str) and figure.std != EXACT:
        raise PlatformError(f"{path}: {section}.{key}: std = {figure.std} of 0 is none: give it in {figure.unit}")
    factor = given.factor / UNITS[wanted].factor
    values = tuple(x * factor for x in figure.value) if isinstance(figure.value, tuple) else figure.value * factor
    return Figure.model_construct(value=values, unit=wanted, std=figure.std_of(factor), source=figure.source)


def _unit_of(model: type[BaseModel], key: str) -> str:
    field = model.model_fields[key]
    found = [part.unit for part in field.metadata if isinstance(part, In)]
    return found[0] if found else "1"
