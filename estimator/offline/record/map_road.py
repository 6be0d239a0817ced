"""The road of a map in a record: where it is declared, it is no finding and hides none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.model.basis import make_basis
from estimator.model.effect import Effect
from estimator.model.effects import effect_with
from estimator.model.parameters import SLOPES, Quantity
from estimator.model.profile import profile_basis
from estimator.offline.record.record import Record, RoadProfile
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.track.track import Track

ROAD: tuple[str, ...] = tuple(effect_with(slope).name for slope in SLOPES)
"""Effects that a map declares."""
MAP_STD = 0.005
"""rad; a surveyed bank or grade against what the car feels: body roll and pitch on the springs add as much"""
FURTHEST_M = 30.0
"""of half the samples from the centre line: road, verges and a pit lane lie within it, another track does not"""


def road_effects() -> tuple[Effect, ...]:
    """What the map says of, always active where it is declared."""
    return tuple(effect_with(slope) for slope in SLOPES)


def road_size(track: Track) -> int:
    """Spline coefficients that a road over the lap of a track has."""
    return make_basis("track_position", track.s, track.length).size


def projected(columns: Mapping[str, Array], track: Track) -> tuple[Array, Array]:
    """Arc length and distance to the left of the centre line of every row, (n,) m each."""
    found: list[tuple[float, float]] = []
    for x, y in zip(columns["x"], columns["y"], strict=True):
        found.append(track.project(float(x), float(y), found[-1][0] if found else None))
    along, left = np.array(found).T
    return along, left


def record_on_map(record: Record, log: DriveLog, track: Track, name: str) -> Record:
    """The record of `log` with the road of the track called `name`.

    Raises:
        InputError: a log without positions, or driven elsewhere.
    """
    if "x" not in log or "y" not in log:
        raise InputError(f"--track {name}: the log has no columns x and y to place it on a track by")
    along, left = projected(log.columns, track)
    if (off := float(np.median(np.abs(left)))) > FURTHEST_M:
        raise InputError(
            f"--track {name}: half of the log is more than {off:.0f} m off its centre line, at most {FURTHEST_M:g} m"
            " are a drive on it: name the track that was driven, with the origin of the log's x and y"
        )
    return with_map_road(on_map(record, track, along), track)


def on_map(record: Record, track: Track, position: Array) -> Record:
    """The record with arc length of the map as its track position: `position` (n,) m."""
    signals = {**record.signals, "track_position": position}
    basis = make_basis("track_position", position, track.length)
    return replace(record, signals=signals, bases={**record.bases, "track_position": basis}, lap_length=track.length)


def with_map_road(record: Record, track: Track) -> Record:
    """The record with bank and grade of the map as what is known of the road."""
    size = record.bases["track_position"].size
    precision = np.eye(size) / MAP_STD**2
    profiles = road_profiles(track, size)
    return replace(record, road={name: RoadProfile(profiles[name], precision) for name in ROAD})


def road_profiles(track: Track, size: int) -> dict[str, Array]:
    """Spline coefficients (size,) of bank and grade over the lap, least squares on the map's points."""
    basis, at = profile_basis(track.s, track.length, size), track.at(track.s)
    angles = {Quantity.BANK: at.bank, Quantity.GRADE: at.grade}
    return {effect_with(slope).name: np.linalg.lstsq(basis, angle, rcond=None)[0] for slope, angle in angles.items()}
