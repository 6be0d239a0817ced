"""VBO files of RaceLogic's loggers: sections of text, numbers apart by spaces, positions in minutes of arc.

Longitude counts west positive, heading clockwise from north; both become a local map, x east and y north, yaw
counter-clockwise from east.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from estimator.drive_log.quantities import is_unit
from estimator.drive_log.text_table import DAY_S, WrittenTable, seconds_of_day
from hil_gateway.config import OriginConfig
from hil_gateway.process.arrays import Array, Ints
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.source import Line, Source
from hil_gateway.track.geodesy import LocalMap

_SECTION = re.compile(r"\s*\[([^\]]+)\]\s*")
OWN_UNITS = {"velocity": "km/h", "velocity kmh": "km/h", "time": "s", "height": "m"}
PLACE = (("lat", "latitude"), ("long", "longitude"))


def recognises(source: Source) -> bool:
    """Whether the sections of such a file are there."""
    sections = {found[1].lower() for line in source.first_lines if (found := _SECTION.fullmatch(line))}
    return "column names" in sections


def read_vbo(path: Path) -> WrittenTable:
    """Columns of the file, with time of day in s, and `x`, `y`, `yaw` instead of latitude, longitude and heading.

    Raises:
        InputError: a section is missing, or a row that is none.
    """
    sections = _sections(path)
    names = [name.lower() for line in sections.get("column names", ()) for name in line.text.split()]
    rows = sections.get("data", [])
    if not names or not rows:
        raise InputError(f"{path}: no rows under [data], or no names under [column names]")
    values = np.array([_row(path, line, names) for line in rows])
    units = _units(sections, names)
    lines = np.array([line.number for line in rows], dtype=np.int64)
    return _localised(names, units, values, lines, sections["column names"][0].number)


def _sections(path: Path) -> dict[str, list[Line]]:
    """Lines by section, without empty ones."""
    found: dict[str, list[Line]] = {}
    section = ""
    for line in Source(path).lines():
        if match := _SECTION.fullmatch(line.text):
            section = match[1].lower()
        elif line.text.strip():
            found.setdefault(section, []).append(line)
    return found


def _row(path: Path, line: Line, names: Sequence[str]) -> list[float]:
    cells = line.text.replace(",", ".").split()
    if len(cells) != len(names):
        raise InputError(f"{path}: row {line.number}: {len(cells)} values for {len(names)} columns")
    try:
        return [_time_of_day(cell) if name == "time" else float(cell) for name, cell in zip(names, cells, strict=True)]
    except ValueError:
        raise InputError(f"{path}: row {line.number}: a value is not a number") from None


def _time_of_day(cell: str) -> float:
    """HHMMSS.ss or HH:MM:SS.ss in s."""
    if (clock := seconds_of_day(cell)) is not None:
        return clock
    whole = int(float(cell))
    return 3600.0 * (whole // 10_000) + 60.0 * (whole // 100 % 100) + whole % 100 + float(cell) % 1.0


def _units(sections: Mapping[str, Sequence[Line]], names: Sequence[str]) -> list[str]:
    """Units of the channels after the receiver's own, as [channel units] lists them."""
    units = [OWN_UNITS.get(name, "") for name in names]
    listed = [line.text.strip() for line in sections.get("channel units", ())]
    for i, unit in enumerate(listed, start=len(names) - len(listed)):
        if 0 <= i < len(names) and is_unit(unit):
            units[i] = unit
    return units


def _localised(names: list[str], units: list[str], values: Array, lines: Ints, header: int) -> WrittenTable:
    at, columns, notes = {name: i for i, name in enumerate(names)}, [*values.T], list[str]()
    if "time" in at:  # of day: goes on after midnight
        clock = columns[at["time"]]
        columns[at["time"]] = clock + DAY_S * np.cumsum(np.diff(clock, prepend=clock[0]) < -0.5 * DAY_S)
    north, west = (next((at[n] for n in known if n in at), None) for known in PLACE)
    if north is not None and west is not None:
        columns[west], columns[north], origin = _on_a_map(columns[north] / 60.0, -columns[west] / 60.0)
        names[west], names[north], units[west], units[north] = "x", "y", "m", "m"
        notes.append(f"x, y are east and north of {origin[0]:.6f}, {origin[1]:.6f} deg, where the log begins")
    if "heading" in at:
        columns[at["heading"]] = np.radians(90.0 - columns[at["heading"]])
        names[at["heading"]], units[at["heading"]] = "course", "rad"
        notes.append("column course is the direction of motion, counter-clockwise from east")
    return WrittenTable(tuple(names), tuple(units), np.column_stack(columns), lines, header, tuple(notes))


def _on_a_map(latitude: Array, longitude: Array) -> tuple[Array, Array, tuple[float, float]]:
    """x, y (n,) m and their origin, the first fix; NaN where there is none."""
    fixed = (latitude != 0.0) | (longitude != 0.0)
    first = int(np.argmax(fixed))
    origin = float(latitude[first]), float(longitude[first])
    local = LocalMap(OriginConfig(latitude=origin[0], longitude=origin[1]))
    places = np.array([local.to_map(a, b) for a, b in zip(latitude, longitude, strict=True)])
    x, y = np.where(fixed[:, None], places, np.nan).T
    return x, y, origin
