"""Named cars over some laps of the tracks: nothing is broken on any of them, so each drives all laps, unstopped and on
the road."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from benchmarks.campaign.laps import commit
from benchmarks.campaign.run import Job
from hil_gateway.config import load_config
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import first_mistake
from hil_gateway.text_file import read_json
from hil_gateway.track.loading import load_track
from planner.simulation.loop import Loop

SLOWEST_M_S = 15.0
"""a car whose laps take longer than at this speed does not arrive"""
START_S = 60.0
"""beyond that, for arming and the standing start"""

Cars = Mapping[str, SimulatedCar]
_CARS: TypeAdapter[dict[str, SimulatedCar]] = TypeAdapter(
    dict[Annotated[str, Field(min_length=1, max_length=80)], SimulatedCar]
)


def read_cars(path: Path) -> Cars:
    """Cars from a file `{"NAME": CAR, ...}`, each as in a car file.

    Raises:
        InputError: unreadable, no car, an unknown key or effect, a value out of range; names file, car and value.
    """
    try:
        cars = _CARS.validate_python(read_json(path, "cars"))
    except ValidationError as error:
        raise InputError(f"{path}: {first_mistake(error)}") from None
    if not cars:
        raise InputError(f'{path} holds nothing; write {{"NAME": CAR, ...}}')
    for name, car in cars.items():
        try:
            car.parameters()
        except InputError as error:
            raise InputError(f"{path}: {name}: {error}") from None
    return cars


@dataclass(frozen=True)
class CarTrial:
    """One car on one track; `car` is the content of a car file."""

    name: str
    track: str
    laps: int
    car: dict[str, Any]

    def job(self) -> Job:
        """This trial as the runner takes it."""
        file = f"car-{self.name}-{Path(self.track).stem or 'road_course'}".replace(" ", "_").replace("/", "_")
        return Job(file, asdict(self), partial(drive_trial, self))


def trials(cars: Cars, tracks: Sequence[str], laps: int, *, deal: bool) -> list[Job]:
    """Every car on every track, or with `deal` each on one of them in turn."""
    # what is usual stays out: an event without an end lasts for ever, which no file can say
    content = {name: car.model_dump(mode="json", exclude_defaults=True) for name, car in cars.items()}
    return [
        CarTrial(name, track, laps, car).job()
        for i, (name, car) in enumerate(content.items())
        for track in ([tracks[i % len(tracks)]] if deal else tracks)
    ]


def drive_trial(trial: CarTrial) -> dict[str, Any]:
    """One drive; keys as in the summary's `drives`."""
    track, config = load_track(trial.track), load_config(None, {"track": trial.track})
    loop = Loop(config, track=track, simulated=SimulatedCar.model_validate(trial.car))
    result = loop.run(laps=trial.laps, time_limit_s=trial.laps * track.length / SLOWEST_M_S + START_S)
    return {
        "settings": asdict(trial),
        "car": trial.name,
        "track": track.name,
        "lap_times_s": [round(t, 3) for t in result.lap_times_s],
        "arrived": result.laps >= trial.laps,
        "stopped": [list(entry) for entry in result.failsafes],
        "off_track": result.off_track,
        "spins": result.spins,
        "worst_margin_m": round(result.worst_margin_m, 3),
        "plan_failures": result.plan_failures,
    }


def summarise(drives: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summary of `hil campaign cars --json`: how many drives of each fate, and every drive."""
    return {
        "drives": list(drives),
        "stopped": sum(bool(drive["stopped"]) for drive in drives),
        "left_the_road": sum(drive["off_track"] > 0 for drive in drives),
        "not_arrived": sum(not drive["arrived"] for drive in drives),
        "commit": commit(),
    }
