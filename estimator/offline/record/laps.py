"""Laps and position along the lap, from what a log offers: lap numbers, positions, or neither."""

from __future__ import annotations

import itertools

import numpy as np

from estimator.drive_log.table import DriveLog
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Ints

SHORTEST_LAP = 27.2
"""Least time of a lap over the car's own time: 15 s for an AV-24."""
WINDOWS_A_BLOCK = 10
"""Whole windows of a block that stands for a lap: none is lost at its ends."""
RETURN_RADIUS = 8.4
"""Wheelbases, 25 m for an AV-24."""


def lap_numbers(log: DriveLog, vehicle: Vehicle, window_s: float) -> tuple[Ints, bool]:
    """(n,) lap of every row, and whether these are real laps (else blocks of time, of whole windows)."""
    if "lap" in log and len(np.unique(log["lap"])) >= 3:
        return log["lap"].astype(np.int64), True
    if "x" in log and "y" in log:
        laps = _laps_from_position(log, vehicle)
        if laps.max() >= 3:
            return laps, True
    passed = log["t"] - log["t"][0] + 0.5 * log.step
    return (passed // (WINDOWS_A_BLOCK * window_s)).astype(np.int64) + 10_000 * log.segment, False


def _laps_from_position(log: DriveLog, vehicle: Vehicle) -> Ints:
    """Counts returns, in the same direction, to where the car was at half its fastest speed for the first time."""
    speed = np.hypot(log["vx"], log["vy"])
    start = int(np.argmax(speed > 0.5 * np.quantile(speed, 0.95)))
    distance = np.hypot(log["x"] - log["x"][start], log["y"] - log["y"][start])
    laps = np.zeros(len(log), np.int64)
    near = distance < RETURN_RADIUS * vehicle.wheelbase
    last = log["t"][start]
    for i in np.flatnonzero(np.diff(near.astype(int)) == 1):
        if i > start and log["t"][i] - last > SHORTEST_LAP * vehicle.own_time:
            stop = i + int(np.argmax(~near[i + 1 :])) + 1
            closest = i + int(np.argmin(distance[i : stop + 1]))
            laps[closest:] += 1
            last = log["t"][closest]
    return laps


def scored_laps(lap: Ints, has_laps: bool) -> tuple[int, ...]:
    """Laps that no fit or choice sees: every third, counted from the last; every fourth block where there are no laps.

    Fixed by their numbers alone. The laps between them tell of what begins late, or in the last lap only, apart.
    """
    numbers = np.unique(lap).tolist()
    return tuple(sorted(numbers[::-3])) if has_laps else tuple(numbers[3::4])


def track_position(log: DriveLog, lap: Ints, has_laps: bool, learnt: Ints) -> tuple[Array, float]:
    """(n,) m along the lap, every lap stretched to the median length, and that length; 0 without laps.

    Where positions are known, along the line of the lap whose length is the median: lines differ from lap to lap by
    several metres, which would blur the edges of a stretch. Median and line are of the laps `learnt` from, less the
    first and the last of the log, which may be broken off.
    """
    if not has_laps:
        return np.zeros(len(log)), 0.0
    step = np.diff(log["t"], prepend=log["t"][0])
    step[1:][np.diff(log.segment) != 0] = 0.0
    travelled = np.cumsum(np.hypot(log["vx"], log["vy"]) * step)
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(lap)) + 1, [len(lap)]])
    lengths = np.array([travelled[b - 1] - travelled[a] for a, b in itertools.pairwise(bounds)])
    whole_laps = np.isin(lap[bounds[:-1]], learnt)
    if np.count_nonzero(whole_laps[1:-1]) > 1:
        whole_laps[[0, -1]] = False
    whole = float(np.median(lengths[whole_laps]))
    position = np.zeros(len(log))
    for (a, b), length in zip(itertools.pairwise(bounds), lengths, strict=True):
        stretch = whole / length if abs(length / whole - 1) < 0.1 else 1.0
        position[a:b] = (travelled[a:b] - travelled[a]) * stretch
    if "x" in log and "y" in log:
        reference = int(np.argmin(np.where(whole_laps, np.abs(lengths - whole), np.inf)))
        rows = slice(bounds[reference], bounds[reference + 1])
        position = _along(position, np.stack([log["x"], log["y"]]), rows, whole)
    return position, whole


def _along(position: Array, place: Array, rows: slice, whole: float) -> Array:
    """(n,) position of the points `place` (2, n) along the line driven in `rows`, by Newton's method from a guess.

    The guess stays where the point is not beside the line: the log then has positions of another kind.
    """
    at, order = np.unique(position[rows], return_index=True)
    stations = np.arange(0.0, whole, STATION_M)
    line = np.stack([np.interp(stations, at, p[rows][order], period=whole) for p in place])
    tangent = (np.roll(line, -1, axis=1) - np.roll(line, 1, axis=1)) / (2 * STATION_M)
    tangent /= np.maximum(np.hypot(*tangent), TINY_M)
    found = position.copy()
    for _ in range(NEWTON_STEPS):
        point, along = (np.stack([np.interp(found, stations, c, period=whole) for c in v]) for v in (line, tangent))
        found += np.sum((place - point) * along, axis=0)
    beside = np.hypot(*(place - point)) < BESIDE_M
    near = np.abs((found - position + 0.5 * whole) % whole - 0.5 * whole) < BESIDE_M
    return np.where(beside & near, found % whole, position)


STATION_M, NEWTON_STEPS, BESIDE_M, TINY_M = 2.0, 4, 30.0, 1e-9
"""Stations of the reference line; steps to the nearest point on it; furthest from it and from the guess."""
