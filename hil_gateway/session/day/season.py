"""Many days together: what each session came to, where that changed over the season, and what else was new then.

A change is a step of the median that Pettitt's test finds (Pettitt, Applied Statistics 28, 1979). Sessions resemble
those before them, so the test counts as many as are worth that many independent ones (Bayley and Hammersley, 1946). A
quantity that a line describes better drifts instead.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import rankdata, spearmanr, theilslopes

from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError

FALSE_ALARM = 0.01
"""Probability that a season in which nothing changed names anything. Where sessions resemble each other it is 1 to 2 %
from 120 sessions on, and up to 5 % for 40."""
LEAST = 5
"""sessions on either side of a change, and of a tyre set or a range of temperature that is compared"""
NEAR = 2
"""sessions: a median steps so close to the change; steps of several quantities within that are one change"""


@dataclass(frozen=True)
class Series:
    """One quantity over the sessions that have it; `std` is nan where nobody states one."""

    name: str
    unit: str
    session: tuple[int, ...]
    value: Array
    std: Array


@dataclass(frozen=True)
class Step:
    """The median goes from `before` to `after` at this session."""

    session: int
    before: float
    after: float


def season(day: dict[str, Any]) -> dict[str, Any]:
    """Series, steps, drifts and changes of what `read_day` found, ready for JSON.

    Raises:
        InputError: no recording that can be read.
    """
    sessions = [s for s in day["sessions"] if "unreadable" not in s]
    if not sessions:
        raise InputError("; ".join(s["unreadable"] for s in day["sessions"]))
    found = list(series(sessions))
    level = FALSE_ALARM / max(len(found), 1)
    rows = [_row(one, sessions, level) for one in found]
    return {
        "sessions": len(day["sessions"]),
        "unreadable": [s["file"] for s in day["sessions"] if "unreadable" in s],
        "changes": list(_changes(rows, sessions)),
        "series": rows,
    }


def series(sessions: Sequence[dict[str, Any]]) -> Iterator[Series]:
    """What is followed, by car."""
    values: dict[tuple[str, str], list[tuple[int, float, float]]] = defaultdict(list)
    cars = {s["car"] for s in sessions}
    for s in sessions:
        where = f"{s['car']}: " if len(cars) > 1 else ""
        for name, unit, value, std in _readings(s):
            values[where + name, unit].append((s["number"], value, std))
    for (name, unit), rows in sorted(values.items()):
        number, means, deviations = zip(*rows, strict=True)
        yield Series(name, unit, number, np.array(means), np.array(deviations))


def _readings(s: dict[str, Any]) -> Iterator[tuple[str, str, float, float]]:
    for tyre in s["tyres_believed"]:
        yield tyre["name"], tyre["unit"], tyre["mean"], tyre["std"]
    learnt = s["revisions"][-1]["parameters"] if s["revisions"] else {}
    for effect, parameters in learnt.items():
        for parameter, value in parameters.items():
            yield f"{effect} {parameter}", "", value, np.nan
    if s["best_lap_s"]:
        yield f"best lap, {s['track']}", "s", s["best_lap_s"], np.nan
    if s["loop_ms"] is not None:
        yield "loop time, 99 of 100", "ms", s["loop_ms"], np.nan
    yield "stops", "", float(len(s["stops"])), np.nan
    yield "channels not explained", "", float(len(s["alerts"])), np.nan


def steps(one: Series, level: float) -> list[Step]:
    """Changes of the median, in order; `level` is the probability of a false one."""
    at = sorted(_split(one.value, 0, level))
    edges = [0, *at, len(one.value)]
    medians = [float(np.median(one.value[a:b])) for a, b in pairwise(edges)]
    return [Step(one.session[i], medians[n], medians[n + 1]) for n, i in enumerate(at)]


def _split(value: Array, offset: int, level: float) -> Iterator[int]:
    """Where the values step, by binary segmentation."""
    place = _pettitt(value, level)
    if place is None:
        return
    yield offset + place
    yield from _split(value[:place], offset, level)
    yield from _split(value[place:], offset + place, level)


def _pettitt(value: Array, level: float) -> int | None:
    """First value after the step; None without one, and where a line describes the values as well."""
    n = len(value)
    if n < 2 * LEAST:
        return None
    u = 2.0 * np.cumsum(rankdata(value))[:-1] - np.arange(1, n) * (n + 1.0)
    place = LEAST + int(np.argmax(np.abs(u[LEAST - 1 : n - LEAST])))
    stepped = np.r_[value[:place] - np.median(value[:place]), value[place:] - np.median(value[place:])]
    probability = 2.0 * np.exp(-6.0 * _worth(stepped) * u[place - 1] ** 2 / (n**3 + n**2))
    if probability > level or np.abs(_off_line(value)).sum() <= np.abs(stepped).sum():
        return None
    return place


def _worth(rest: Array) -> float:
    """Independent values that one of these is worth, 0 to 1: the correlation of neighbours, without the bias of a short
    series (Marriott and Pope, 1954), makes of n values n (1 - r) / (1 + r)."""
    power = float(rest @ rest)
    seen = rest[1:] @ rest[:-1] / power if power else 0.0
    alike = float(np.clip(seen + (1.0 + 4.0 * seen) / len(rest), 0.0, 0.99))
    return (1.0 - alike) / (1.0 + alike)


def _off_line(value: Array) -> Array:
    """Distances from the line through the medians of all slopes."""
    at = np.arange(len(value))
    slope, intercept, *_ = theilslopes(value, at)
    return np.asarray(value - slope * at - intercept)


def _row(one: Series, sessions: Sequence[dict[str, Any]], level: float) -> dict[str, Any]:
    by_number = {s["number"]: s for s in sessions}
    of = [by_number[number] for number in one.session]
    found = steps(one, level)
    return {
        "name": one.name, "unit": one.unit, "session": list(one.session), "value": one.value.tolist(),
        "std": [None if np.isnan(std) else std for std in one.std.tolist()],
        "steps": [{"session": s.session, "before": s.before, "after": s.after} for s in found],
        "drift": None if found else _slope(np.arange(len(of), dtype=float), one.value, level),
        "per_10_c": _warmth(of, one.value, level), "tyres": _by_tyres(of, one.value),
    }  # fmt: skip


def _slope(at: Array, value: Array, level: float) -> float | None:
    """Median slope; None where chance explains it."""
    if len(value) < 2 * LEAST or np.ptp(at) == 0.0 or np.ptp(value) == 0.0:
        return None
    chance = spearmanr(at, value).pvalue ** _worth(_off_line(value))  # its logarithm goes with their number
    return float(theilslopes(value, at)[0]) if chance <= level else None


def _warmth(of: Sequence[dict[str, Any]], value: Array, level: float) -> float | None:
    """Change for 10 deg C more of the road, else of the air, where people noted it."""
    noted = [s["weather"].get("road_c", s["weather"].get("air_c")) for s in of]
    known = [i for i, celsius in enumerate(noted) if celsius is not None]
    slope = _slope(np.array([noted[i] for i in known]), value[known], level) if known else None
    return None if slope is None else 10.0 * slope


def _by_tyres(of: Sequence[dict[str, Any]], value: Array) -> dict[str, float]:
    """Median by tyre set, of sets that were alone on the car in enough sessions."""
    sets: dict[str, list[float]] = defaultdict(list)
    for s, one in zip(of, value.tolist(), strict=True):
        if len(s["tyres"]) == 1:
            sets[next(iter(s["tyres"]))].append(one)
    return {name: float(np.median(values)) for name, values in sets.items() if len(values) >= LEAST and name}


def _changes(rows: Sequence[dict[str, Any]], sessions: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Steps that fall together, with what else was new."""
    every = sorted(((step["session"], row, step) for row in rows for step in row["steps"]), key=lambda found: found[0])
    while every:
        together = [found for found in every if found[0] <= every[0][0] + NEAR]
        every = every[len(together) :]
        numbers = [number for number, _, _ in together]
        number = max(set(numbers), key=numbers.count)
        moved = [{"name": row["name"], "unit": row["unit"], **step} for _, row, step in together]
        yield {"session": number, "moved": moved, "new": list(_new(sessions, number))}


def _new(sessions: Sequence[dict[str, Any]], number: int) -> Iterator[str]:
    """What differs between the sessions around the change, and what people said there."""
    place = next(i for i, s in enumerate(sessions) if s["number"] == number)
    before, after = sessions[max(place - 1, 0)], sessions[place]
    for what in ("car", "track", "software"):
        if before[what] != after[what]:
            yield f"{what} {before[what]} to {after[what]}"
    worn, fresh = (", ".join(s["tyres"]) for s in (before, after))
    if worn != fresh:
        yield f"tyre set {worn or 'not named'} to {fresh or 'not named'}"
    for s in sessions[max(place - 1, 0) : place + 2]:
        yield from (f'"{note["text"]}" in session {s["number"]}' for note in s["remarks"] if note["text"])
