"""What the final model leaves beyond noise: in which channel, depending on what, and where or when.

Looked for on the laps learnt from and on the laps scored: what acts in scored laps only is a finding as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.model.single_track import CHANNELS, SingleTrack
from estimator.offline.record.record import LATERAL_ROWS, Record
from estimator.offline.result.diagnosis_score import channel_residuals
from estimator.offline.search.acceptance import BEYOND_NOISE
from estimator.offline.search.empirical import explanatory
from estimator.offline.search.stretches.cells import MOST, Candidate
from hil_gateway.process.arrays import Array, Ints

AVERAGED_S = 0.2
"""Residuals are averaged so long before anything is sought in them: noise that is white falls, structure stays."""
BINS = 40
"""of each signal, with equally many samples; over time of equal length"""
EXPLAINS = 0.15
"""Share of the averages' variance that a signal must explain to be named; below, track position or time say where."""
SHORT_S = 5.0
"""Stretches of time that show what comes and goes: shorter than that, corners and pedals come and go."""
TIMES_OVER = 2.0
"""They follow whatever varies slowly, and are the cause where they explain so many times what any signal does."""
RESPONSES = ("vy", "ay", "yaw_rate")
"""What follows from a force across the car as much as a force follows from it."""
PLACED = ("t", "track_position", "yaw", "x", "y")
"""What says when and where, and is no cause."""
NEARLY_ALL = 0.8
"""Share of what is beyond noise."""
CELL_M = 40.0
"""Of the lap: what a car does there it does for a second."""
ACTIVE = 0.5
"""Share of the strongest bin's mean square from which on a bin counts."""


@dataclass(frozen=True)
class Leftover:
    """A channel's residual beyond noise.

    Attributes:
        channel: of `CHANNELS`; ratio: RMS over the noise floor, on the laps learnt from or scored, the larger.
        only_scored: whether only the scored laps show it.
        signal: what the residual depends on; spans: (from, to) of that signal where it is strongest.
        reach: smallest and largest value of the signal.
        places: (lap, from, to) in m of each span of time, where there are laps.
        grip: another grip on a stretch of some laps, where that holds most of it; elsewhere: what is left outside.
    """

    channel: str
    ratio: float
    only_scored: bool
    signal: str
    spans: tuple[tuple[float, float], ...]
    reach: tuple[float, float]
    places: tuple[tuple[int, float, float], ...] = ()
    grip: Candidate | None = None
    elsewhere: float = 0.0

    @property
    def share(self) -> float:
        """Of the squared residual that is not noise."""
        return 1.0 - 1.0 / self.ratio**2

    def at_places(self, record: Record) -> Leftover:
        """The same with laps and places of its spans of time."""
        if self.signal != "t" or not record.has_laps:
            return self
        t, position = record.signals["t"], record.signals["track_position"]
        places = []
        for start, end in self.spans:
            rows = np.flatnonzero((t >= start) & (t <= end))
            for lap in np.unique(record.lap_of_row[rows]).tolist():
                there = position[rows[record.lap_of_row[rows] == lap]]
                places.append((lap, float(there.min()), float(there.max())))
        return replace(self, places=tuple(places))


def leftovers(  # noqa: PLR0917 - what is left of what, over what, and why
    record: Record,
    test_rows: Ints,
    model: SingleTrack,
    parameters: Array,
    floor: Mapping[str, float],
    grip: Candidate | None = None,
) -> tuple[Leftover, ...]:
    """Channels measured by a sensor of their own whose residual exceeds noise, strongest first.

    `grip` is a stretch of the `record` that would gain by another grip.
    """
    rows = np.sort(record.rows.ravel())
    residuals = channel_residuals(record, rows, model, parameters)
    found = []
    for c, channel in enumerate(CHANNELS):
        at, residual = residuals[channel]
        scored = np.isin(at, test_rows)
        known, new = (float(np.sqrt(np.mean(residual[part] ** 2))) / floor[channel] for part in (~scored, scored))
        if record.used[c] and max(known, new) > BEYOND_NOISE:
            only_scored = known <= BEYOND_NOISE
            part = scored if only_scored else np.ones_like(scored)
            where = _where(record, at[part], residual[part])
            if only_scored and where[0] == "t":
                where = _beyond_reach(record, at, scored, residual**2 - floor[channel] ** 2) or where
            left = Leftover(channel, max(known, new), only_scored, *where)
            of_grip = grip and _with_grip(left, record, (at[part], residual[part]), floor[channel], grip)
            found.append(of_grip or left.at_places(record))
    return tuple(sorted(found, key=lambda left: -left.ratio))


def _beyond_reach(
    record: Record, rows: Ints, scored: NDArray[np.bool_], excess: Array
) -> tuple[str, tuple[tuple[float, float], ...], tuple[float, float]] | None:
    """Signal that the scored laps drive beyond the laps learnt from, where nearly all `excess` (n,) is: its law.

    None where no cause holds that much, or where it came once: then anything that happened there and then would do.
    """
    t = record.signals["t"]
    total, held = float(excess[scored].sum()), {}
    for name in sorted(set(explanatory(record)) - {*RESPONSES, *PLACED}):
        values = record.signals[name][rows]
        known = values[~scored]
        for beyond in (scored & (values > known.max()), scored & (values < known.min())):
            each = _by_passage(t[rows[beyond]], excess[beyond]) / total
            if len(each) > 1 and each.sum() > NEARLY_ALL and each[1] > EXPLAINS:
                inside = values[beyond]
                held[float(each.sum())] = name, ((float(inside.min()), float(inside.max())),), _reach(values[scored])
    return held[max(held)] if held else None


def _by_passage(t: Array, excess: Array) -> Array:
    """(passages,) sums of the `excess` (n,) at times (n,), largest first; none is within `SHORT_S` of another."""
    passage = np.cumsum(np.diff(t, prepend=t[:1]) > SHORT_S)
    return np.sort(np.bincount(passage, excess).astype(np.float64))[::-1]


def _reach(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _with_grip(
    left: Leftover, record: Record, residuals: tuple[Ints, Array], floor: float, grip: Candidate
) -> Leftover | None:
    """Said of a stretch of other grip, where a lateral channel has most of its `residuals` (rows and values) there."""
    rows, residual = residuals
    inside = grip.stretch.covers(record)[rows] > 0.0
    excess = residual**2 - floor**2
    if CHANNELS.index(left.channel) not in LATERAL_ROWS or not excess[inside].sum() > MOST * excess.sum():
        return None
    span, reach = (grip.stretch.start, grip.stretch.end), (0.0, record.lap_length)
    outside = float(np.sqrt(np.mean(residual[~inside] ** 2)))
    return replace(left, signal="track_position", spans=(span,), reach=reach, grip=grip, elsewhere=outside)


def _where(
    record: Record, rows: Ints, residual: Array
) -> tuple[str, tuple[tuple[float, float], ...], tuple[float, float]]:
    """Signal that explains most of the averaged residual, the spans where it is strongest, and the signal's reach."""
    size = max(1, round(AVERAGED_S / record.step))
    count = len(rows) // size * size
    mean = residual[:count].reshape(-1, size).mean(axis=1)
    middle = rows[:count].reshape(-1, size)[:, size // 2]
    valued = {n: _values(record, n, middle) for n in explanatory(record)}
    groups = {n: _groups(values, n) for n, values in valued.items()}
    shares = {n: _explained(mean, g) for n, g in groups.items()}
    signal, short = max(shares, key=lambda n: shares[n]), _stretches(record.signals["t"][middle])
    no_cause = record.has_laps and (shares[signal] < EXPLAINS or signal in RESPONSES)
    once = no_cause and comes_back(record, middle, mean) < EXPLAINS
    if once or _explained(mean, short) > max(EXPLAINS, TIMES_OVER * shares[signal]):
        signal, groups["t"] = "t", short
    elif shares[signal] < EXPLAINS:
        groups["t"] = short
        signal = max((n for n in ("track_position", "t") if n in groups), key=lambda n: _explained(mean**2, groups[n]))
    values = valued[signal]
    return signal, _spans(values, groups[signal], mean**2), _reach(values)


def _values(record: Record, signal: str, rows: Ints) -> Array:
    """(n,) of a signal; within its period, where it has one: a heading that goes on from lap to lap tells the time."""
    period, values = record.bases[signal].period, record.signals[signal][rows]
    return np.asarray(np.mod(values, period)) if period else values


def comes_back(record: Record, rows: Ints, mean: Array) -> float:
    """Share of the averaged residual that is there again in another lap at the same place, as any law of the motion is.

    1 where no two laps tell.
    """
    cell = np.floor(record.signals["track_position"][rows] / (CELL_M * record.size)).astype(np.int64)
    laps, lap = np.unique(record.lap_of_row[rows], return_inverse=True)
    sums, count = np.zeros((2, len(laps), cell.max() + 1))
    np.add.at(sums, (lap, cell), mean)
    np.add.at(count, (lap, cell), 1.0)
    there = count > 0
    average = np.divide(sums, count, out=np.zeros_like(sums), where=there)
    both = there[:-1] & there[1:]
    one, other = average[:-1][both], average[1:][both]
    square = 0.5 * float(np.sum(one**2 + other**2))
    return float(np.sum(one * other)) / square if square > 0.0 else 1.0


def _stretches(t: Array) -> Ints:
    """(n,) number of the short stretch of time."""
    number: Ints = np.floor((t - t.min()) / SHORT_S).astype(np.int64)
    return number


def _groups(values: Array, signal: str) -> Ints:
    """(n,) number of the bin of each value."""
    if signal == "t":
        edges = np.linspace(values.min(), values.max(), BINS + 1)[1:-1]
    else:
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
    return np.searchsorted(edges, values).astype(np.int64)


def _explained(values: Array, group: Ints) -> float:
    """Share of the variance between groups, less what chance gives so many groups."""
    count = np.bincount(group)
    sums, squares = np.bincount(group, values), np.bincount(group, values**2)
    within = float(np.sum(squares - sums**2 / np.maximum(count, 1)))
    free = max(len(values) - int(np.count_nonzero(count)), 1)
    return 1.0 - within / free / max(float(values.var(ddof=1)), 1e-300)


def _spans(values: Array, group: Ints, square: Array) -> tuple[tuple[float, float], ...]:
    """Runs of neighbouring bins whose mean square is near the largest, at most three, strongest first."""
    numbers = np.unique(group)
    size = np.array([square[group == g].mean() for g in numbers])
    active = np.concatenate([[0], (size > ACTIVE * size.max()).astype(int), [0]])
    edges = np.flatnonzero(np.diff(active))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    runs = sorted(pairs, key=lambda run: -float(size[run[0] : run[1]].sum()))
    inside = [values[(group >= numbers[a]) & (group <= numbers[b - 1])] for a, b in runs[:3]]
    return tuple((float(v.min()), float(v.max())) for v in inside)
