"""Cars nobody has driven through events they are not told of: a wet stretch, a gust, a puncture, brakes that fade.

Every case is a drive of its own, from a standing start, on virtual time; a drive of the same length without events
says what the event costs. What happens on the road comes from the plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from benchmarks.campaign.laps import commit
from benchmarks.campaign.run import Job
from benchmarks.driving.random_car import random_car
from hil_gateway.config import load_config
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.plant.events import Event
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import first_mistake
from hil_gateway.text_file import read_json
from hil_gateway.track.loading import load_track
from planner.simulation.loop import Loop, LoopResult

UNDISTURBED = "undisturbed"
AFTER_S = 15.0
"""s a drive goes on after the last event has begun: a car at 60 m/s that stops at 6 m/s2 stands after 10"""
LONGEST_S = 1200.0
"""latest begin of an event: what comes later is no case to wait for"""

Cases = Mapping[str, tuple[Event, ...]]
_CASES: TypeAdapter[dict[Annotated[str, Field(min_length=1, max_length=40)], tuple[Event, ...]]] = TypeAdapter(
    dict[Annotated[str, Field(min_length=1, max_length=40)], tuple[Event, ...]]
)


def read_cases(path: Path) -> Cases:
    """Named lists of events, one a case, from a file `{"NAME": [EVENT, ...], ...}` with events as in a car file.

    Raises:
        InputError: unreadable, no events, an unknown kind or key, a value out of range; names file, place and value.
    """
    try:
        cases = _CASES.validate_python(read_json(path, "events"))
    except ValidationError as error:
        raise InputError(f"{path}: {first_mistake(error)}") from None
    for name, events in {"the file": tuple(cases), **cases}.items():
        if not events:
            raise InputError(f'{path}: {name} holds nothing; write {{"NAME": [EVENT, ...]}}')
    if UNDISTURBED in cases:
        raise InputError(f"{path}: {UNDISTURBED}: the name of the drive without events; choose another")
    if (latest := _latest(cases)) > LONGEST_S:
        raise InputError(f"{path}: t = {latest:g}: an event begins after {LONGEST_S:g} s at the latest")
    return cases


def _latest(cases: Cases) -> float:
    """When the last event of all begins, s."""
    return max(event.t for events in cases.values() for event in events)


@dataclass(frozen=True)
class EventTrial:
    """One car through one case; `events` as in a car file, `seconds` from arming to the end."""

    seed: int
    track: str
    case: str
    events: tuple[dict[str, Any], ...]
    seconds: float

    @property
    def name(self) -> str:
        """Name of its result file."""
        return f"event-{self.seed:03d}-{Path(self.track).stem or 'road_course'}-{self.case.replace(' ', '_')}"

    def job(self) -> Job:
        """This trial as the runner takes it."""
        return Job(self.name, asdict(self), partial(drive_trial, self))


def trials(seeds: Sequence[int], tracks: Sequence[str], cases: Cases) -> list[Job]:
    """Cars dealt out over the tracks in turn, every one through no event and through every case."""
    seconds = _latest(cases) + AFTER_S
    return [
        EventTrial(seed, tracks[i % len(tracks)], name, tuple(_plain(event) for event in events), seconds).job()
        for i, seed in enumerate(seeds)
        for name, events in {UNDISTURBED: (), **cases}.items()
    ]


def _plain(event: Event) -> dict[str, Any]:
    # what is usual stays out: an event without an end lasts for ever, which no file can say
    return event.model_dump(mode="json", exclude_defaults=True)


def drive_trial(trial: EventTrial) -> dict[str, Any]:
    """One drive; keys as in the summary's `drives`."""
    car = SimulatedCar.model_validate({**random_car(trial.seed).model_dump(), "events": trial.events})
    track, config = load_track(trial.track), load_config(None, {"track": trial.track, "plant.seed": trial.seed})
    loop = Loop(config, track=track, simulated=car)
    result = loop.run(seconds=trial.seconds)
    return {
        "settings": asdict(trial), "seed": trial.seed, "track": track.name, "case": trial.case, **_figures(result),
    }  # fmt: skip


def _figures(result: LoopResult) -> dict[str, Any]:
    return {
        "off_track": result.off_track,
        "spins": result.spins,
        "stopped": [list(entry) for entry in result.failsafes],
        "worst_margin_m": round(result.worst_margin_m, 3),
        "friction_over_s": round(result.friction_over_s, 3),
        "distance_m": round(result.distance_m, 1),
        "plan_failures": result.plan_failures,
    }


def summarise(drives: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summary of `hil campaign laps --events FILE --json`; `lost_m` is against the same car's undisturbed drive."""
    alone = {(d["seed"], d["track"]): d["distance_m"] for d in drives if d["case"] == UNDISTURBED}
    compared = [{**d, "lost_m": round(alone[d["seed"], d["track"]] - d["distance_m"], 1)} for d in drives]
    names = dict.fromkeys(d["case"] for d in drives)
    return {
        "drives": compared,
        "cases": {name: _of_case([d for d in compared if d["case"] == name]) for name in names},
        "commit": commit(),
    }


def _of_case(drives: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How many cars drove, left the road, span, stopped by themselves; the least margin."""
    return {
        "drives": len(drives),
        "off_track": sum(d["off_track"] > 0 for d in drives),
        "spun": sum(d["spins"] > 0 for d in drives),
        "stopped": sum(bool(d["stopped"]) for d in drives),
        "worst_margin_m": min(d["worst_margin_m"] for d in drives),
        "most_lost_m": max(d["lost_m"] for d in drives),
    }
