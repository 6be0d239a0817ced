"""The road of the map in a record and in a revision: where it is declared, it is no finding and hides none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.model.basis import make_basis
from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.model.profile import profile_basis
from estimator.offline.record.record import Record, RoadProfile
from hil_gateway.bus.messages import ActiveEffect, ModelRevision
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track

ROAD: tuple[str, ...] = ("road_bank", "road_grade")
MAP_STD = 0.005
"""rad; a surveyed bank or grade against what the car feels: body roll and pitch on the springs add as much"""


def road_effects() -> tuple[Effect, ...]:
    """What the map says of, always active where it is declared."""
    return tuple(catalogue()[name] for name in ROAD)


def road_size(track: Track) -> int:
    """Spline coefficients that a road over the lap of a track has."""
    return make_basis("track_position", track.s, track.length).size


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
    angles = {"road_bank": at.bank, "road_grade": at.grade}
    return {name: np.linalg.lstsq(basis, angle, rcond=None)[0] for name, angle in angles.items()}


def with_road(revision: ModelRevision, track: Track) -> ModelRevision:
    """A revision that also has the map's road, as the planner adds it: for predictions only."""
    road = (
        ActiveEffect(name=name, parameters={}, profile=tuple(values.tolist()))
        for name, values in road_profiles(track, road_size(track)).items()
    )
    return revision.model_copy(update={"effects": (*revision.effects, *road)})
