"""The referee's yardstick: the least time in which the simulated car itself can lap a track.

From the plant's own equations only: its g-g-v diagram by quasi-steady manoeuvres, a minimum-time line within the track,
and the fastest quasi-steady speed along it. Actuators act at once, gears shift in no time, brake pressures of both
axles are free, and events are left out: the time is a bound that driving approaches. Nothing that drives may use it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics.parameters import PlantParameters
from hil_gateway.plant.referee.limit_envelope import TOP_SPEED, LimitEnvelope, NoEquilibriumError, measure_envelope
from hil_gateway.plant.referee.limit_line import NoLineError, fastest_line
from hil_gateway.plant.referee.limit_profile import fastest_profile, lap_time
from hil_gateway.plant.referee.referee import HALF_WIDTH_M
from hil_gateway.process.arrays import Array
from hil_gateway.process.cache import cache_directory
from hil_gateway.process.errors import InputError
from hil_gateway.track.track import Track

VERSION = 2
"""of the method; part of the cache key"""
SHAPE = ("x", "y", "width_left", "width_right", "grade", "bank")
"""what of a track the time depends on"""
REDUCED_GRIP = 0.9
"""share of the friction at which the second time is given"""
METHOD = (
    "quasi-steady: g-g-v diagram of the plant's own equations (load transfer, aero, load sensitivity, combined slip,"
    " engine map, gears, wind, free brake balance), minimum-time line with every wheel on the road"
    f" (centre {HALF_WIDTH_M} m from the edges), grade, bank and vertical curvature, at most {TOP_SPEED:g} m/s"
)


@dataclass(frozen=True)
class LapLimit:
    """Least lap time, s, and the largest speed on that lap, m/s."""

    limit_s: float
    peak_speed_mps: float


def lap_limit(parameters: PlantParameters, track: Track, grip: float = 1.0) -> LapLimit:
    """Least lap time of a car on a track, with all its friction times `grip`; from the cache where it is known.

    Raises:
        InputError: a car that cannot be balanced, or a track without a minimum-time line.
    """
    key = _key(parameters, grip, *(getattr(track, name) for name in SHAPE))
    return LapLimit(**_remembered(f"limit-{key}", lambda: asdict(_compute(parameters, track, grip))))


def lateral_limit(parameters: PlantParameters, speeds: Sequence[float]) -> Array:
    """Largest lateral force over mass of a car on level ground without wind, m/s2, mean of both sides, shape (n,).

    Raises:
        NoEquilibriumError: a car that cannot be balanced.
    """

    def measured() -> dict[str, Any]:
        v = np.array(speeds)
        envelope, calm, normal = measure_envelope(parameters), np.zeros_like(v), np.full_like(v, GRAVITY)
        sides = [envelope.peak(np.full(v.shape, left), calm, v, normal) for left in (False, True)]
        return {"lateral": np.mean(sides, axis=0).tolist()}

    return np.array(_remembered(f"lateral-{_key(parameters, 1.0, np.array(speeds))}", measured)["lateral"])


def _remembered(name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """From the cache where it is there, else computed and put there."""
    path = cache_directory() / f"{name}.json"
    try:
        return dict(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError):
        found = compute()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(f".{id(found)}").write_text(json.dumps(found))
    path.with_suffix(f".{id(found)}").replace(path)
    return found


def _compute(parameters: PlantParameters, track: Track, grip: float) -> LapLimit:
    try:
        envelope: LimitEnvelope = measure_envelope(parameters, grip)
        path = fastest_line(track, parameters, envelope, HALF_WIDTH_M)
    except (NoEquilibriumError, NoLineError) as error:
        raise InputError(f"track {track.name}: the car's lap limit cannot be found: {error}") from None
    speed = fastest_profile(path, envelope, parameters.car)
    return LapLimit(round(lap_time(speed, path.step), 3), round(float(speed.max()), 2))


def _key(parameters: PlantParameters, grip: float, *arrays: Array) -> str:
    """Content of everything a result depends on."""
    car_and_road = parameters.car, parameters.road, parameters.gears, parameters.final_drive
    digest = hashlib.sha256(repr((VERSION, METHOD, grip, car_and_road)).encode())
    for values in arrays:
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:32]


def limit_report(parameters: PlantParameters, track: Track) -> dict[str, float | str]:
    """What `hil plan limit --json` prints.

    Raises:
        InputError: see `lap_limit`.
    """
    limit, reduced = lap_limit(parameters, track), lap_limit(parameters, track, REDUCED_GRIP)
    return {**asdict(limit), "limit_90_s": reduced.limit_s, "track": track.name, "method": METHOD}


def lap_ratios(lap_times_s: Sequence[float], limit_s: float) -> list[float]:
    """Lap times over the limit."""
    return [round(t / limit_s, 4) for t in lap_times_s]
