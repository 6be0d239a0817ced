"""Which column of a file is which quantity, in which unit and sign, how late: proposed from names, or said by a person.

A map file is TOML, one table a quantity:

    [vx]
    from = "Ground Speed"
    unit = "km/h"
    sign = 1        # -1 where the file counts the other way
    delay = 0.0     # s that the channel lags the others
    ratio = 1.0     # of the steering: angle in the file over that of the road wheel

A quantity that a map does not name is not used. Every conversion becomes a line of the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, ValidationError

from estimator.drive_log.quantities import NO_UNIT, QUANTITIES, UNITS, normal_unit, plain_name, quantity_of, to_si
from hil_gateway.process.arrays import Array, Ints
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model
from hil_gateway.text_file import read_toml


class ColumnSource(Model):
    """Where a quantity comes from."""

    source: str = Field(alias="from")
    unit: str = ""
    sign: Literal[1, -1] = 1
    delay: float = Field(default=0.0, ge=-5.0, le=5.0)
    ratio: float = Field(default=1.0, gt=0.0, le=100.0)


@dataclass(frozen=True)
class ColumnMap:
    """quantity -> its source; `declared` where a person said so."""

    sources: Mapping[str, ColumnSource]
    declared: bool = False


def read_map(path: Path) -> ColumnMap:
    """A map file.

    Raises:
        InputError: unreadable, an unknown quantity, key or unit.
    """
    sources = {}
    for name, entry in read_toml(path, "column map").items():
        if name not in QUANTITIES:
            raise InputError(f"{path}: [{name}]: no quantity of a drive log; known are {', '.join(QUANTITIES)}")
        try:
            sources[name] = ColumnSource.model_validate(entry)
        except ValidationError as error:
            first = error.errors()[0]
            raise InputError(f"{path}: [{name}] {'.'.join(map(str, first['loc']))}: {first['msg'].lower()}") from None
        if sources[name].unit and to_si(name, sources[name].unit) is None:
            raise InputError(f"{path}: [{name}] unit = {sources[name].unit!r}: {_known_units(name)}")
    _check_sense(path, sources)
    return ColumnMap(sources, declared=True)


def _check_sense(path: Path, sources: Mapping[str, ColumnSource]) -> None:
    """What is well written and cannot be meant."""
    quantity_from = dict[str, str]()
    for name, source in sources.items():
        if (other := quantity_from.setdefault(source.source, name)) != name:
            raise InputError(
                f"{path}: [{name}] from = {source.source!r}: [{other}] has it already; name another column"
            )
        if name == "t" and (source.sign != 1 or source.delay):
            raise InputError(f"{path}: [t] has a sign or a delay; give the delay to the channels that lag")
        if name != "steer" and source.ratio != 1.0:
            raise InputError(f"{path}: [{name}] ratio = {source.ratio:g}: only [steer] has one")


def _known_units(name: str) -> str:
    dimension = QUANTITIES[name].dimension
    return f"no unit of {name} ({dimension}); known are {', '.join(u for u in UNITS[dimension] if u)}"


def proposed(names: Sequence[str], units: Sequence[str]) -> ColumnMap:
    """The map that names and units of a file suggest; of several columns for one quantity the best known name."""
    best: dict[str, tuple[int, ColumnSource]] = {}
    for name, unit in zip(names, units, strict=True):
        if (found := quantity_of(name)) is None:
            continue
        quantity, by_name = found
        rank = _rank(quantity, name)
        if quantity not in best or rank < best[quantity][0]:
            best[quantity] = rank, ColumnSource.model_validate({"from": name, "unit": unit or by_name})
    return ColumnMap({quantity: source for quantity, (_, source) in best.items()})


def _rank(quantity: str, name: str) -> int:
    """0 for the quantity's own name, then in the order of its names."""
    known = (plain_name(quantity), *QUANTITIES[quantity].names)
    return -1 if name == quantity else next((i for i, n in enumerate(known) if n == plain_name(name)), len(known))


def apply(
    path: Path, header: int, names: Sequence[str], values: Array, mapping: ColumnMap
) -> tuple[dict[str, Array], list[str]]:
    """Columns by quantity in SI, the other ones by their own names, and a note for every conversion.

    Raises:
        InputError: a source that is not there, a unit of another dimension.
    """
    columns: dict[str, Array] = {}
    notes: list[str] = []
    for quantity, source in mapping.sources.items():
        if source.source not in names:
            raise InputError(
                f"{path}: row {header}: column {source.source} of {quantity} is missing; found {', '.join(names)}"
            )
        factor = _factor(path, quantity, source)
        column = values[:, list(names).index(source.source)]
        columns[quantity] = column if factor == 1.0 else factor * column
        notes += _conversion_notes(quantity, source, factor)
    used = {source.source for source in mapping.sources.values()}
    rest = [name for name in names if name not in used and name not in columns]
    unused = [name for name in rest if mapping.declared and name in QUANTITIES]
    notes += [f"column {name} is not in the map: left out" for name in unused]
    columns |= {name: values[:, list(names).index(name)] for name in rest if name not in unused}
    return columns, notes


def _factor(path: Path, quantity: str, source: ColumnSource) -> float:
    if normal_unit(source.unit) in NO_UNIT:
        return float(source.sign) / source.ratio
    factor = to_si(quantity, source.unit)
    if factor is None:
        raise InputError(
            f"{path}: column {source.source}, taken for {quantity}: unit {source.unit!r} is {_known_units(quantity)};"
            " say with --columns what it is"
        )
    return source.sign * factor / source.ratio


def _conversion_notes(quantity: str, source: ColumnSource, factor: float) -> list[str]:
    own = quantity == source.source
    if own and factor == 1.0:
        return []
    unit = f" in {source.unit}" if source.unit else ", no unit given: taken as SI"
    return [f"{quantity} is {source.source!r}{unit}" + ("" if factor == 1.0 else f": multiplied by {factor:.6g}")]


def without_delays(
    columns: Mapping[str, Array], lines: Ints, mapping: ColumnMap, notes: list[str]
) -> tuple[dict[str, Array], Ints]:
    """Channels that lag put where the others are, by interpolation, and the lines (n,) of the rows that all reach.

    `columns` with `t` in s, increasing.
    """
    t = columns["t"]
    lags = {name: source.delay for name, source in mapping.sources.items() if source.delay}
    there = np.ones(len(t), bool)
    moved = dict(columns)
    for name, lag in lags.items():
        there &= (t + lag >= t[0]) & (t + lag <= t[-1])
        moved[name] = np.interp(t + lag, t, columns[name])
        notes.append(f"{name} is put {lag:g} s earlier, as declared")
    return {name: values[there] for name, values in moved.items()}, lines[there]


def as_toml(mapping: ColumnMap) -> str:
    """The map as a file for a person to confirm or change."""
    import tomli_w

    return tomli_w.dumps({q: s.model_dump(by_alias=True) for q, s in mapping.sources.items()})
