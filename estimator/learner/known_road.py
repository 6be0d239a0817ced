"""The road of the map in a model revision, as the planner adds it."""

from __future__ import annotations

from estimator.offline.record.map_road import road_profiles, road_size
from hil_gateway.bus.messages import ActiveEffect, ModelRevision
from hil_gateway.track.track import Track


def with_road(revision: ModelRevision, track: Track) -> ModelRevision:
    """A revision that also has the map's road, as the planner adds it: for predictions only."""
    road = (
        ActiveEffect(name=name, parameters={}, profile=tuple(values.tolist()))
        for name, values in road_profiles(track, road_size(track)).items()
    )
    return revision.model_copy(update={"effects": (*revision.effects, *road)})
