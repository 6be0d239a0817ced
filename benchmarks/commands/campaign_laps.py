"""Command line of the lap campaign."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmarks.commands.options import CORES, AsJson, FirstSeed, Processes, Scheduler, Tracks
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import figure, print_json
from hil_gateway.process.writable import check_folder

if TYPE_CHECKING:
    from benchmarks.campaign.run import Job

TRACKS = "road_course,oval,tri_oval"
FAILURES = "off_track", "spins", "slides", "laps_missing"
"""what of a summary must be none"""


def laps(  # noqa: PLR0917  (one argument a flag)
    cars: Annotated[int, typer.Option(min=1, help="cars, dealt out over the tracks in turn")] = 3,
    first_seed: FirstSeed = 0,
    laps: Annotated[int, typer.Option(min=1, help="laps of the first session")] = 10,
    tracks: Tracks = TRACKS,
    car: Annotated[Path | None, typer.Option(help="simulated car (JSON) in place of random ones")] = None,
    events: Annotated[
        Path | None, typer.Option(help="named lists of events (JSON): drive every car through each, instead of laps")
    ] = None,
    without: Annotated[
        bool, typer.Option("--without-learning/--only-learning", help="drive every car without learning too")
    ] = True,
    scheduler: Scheduler = "",
    processes: Processes = CORES,
    out: Annotated[Path, typer.Option(help="folder of trials; trials in it are not driven again")]
    = Path("campaign-laps"),
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Laps of cars nobody has driven over the limit of that very car, judged by the plant.

    Resumable: interrupted, the same command goes on where it stopped. Exit 1 when a car leaves the road, spins, does
    not drive all laps, or has an axle beyond the peak of its tyres for more than 0.2 s; with events when one leaves the
    road.
    """
    from hil_gateway.track.loading import load_track

    check_folder(out, ("summary.json",))
    if events is not None and car is not None:
        raise InputError("--car with --events: a car file has events of its own; leave one of them out")
    names = [name.strip() for name in tracks.split(",") if name.strip()] or [""]
    for name in names:
        load_track(name)
    drives = _Drives(range(first_seed, first_seed + cars), names, out, processes, scheduler)
    summary = drives.laps(laps, car, without) if events is None else drives.through(events)
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    if as_json:
        print_json(summary)
    else:
        print("\n".join(_describe(summary) if events is None else _describe_cases(summary)))
    if any(part[key] for part in summary.get("cases", {"": summary}).values() for key in FAILURES if key in part):
        raise typer.Exit(EXIT_FAILURE)


@dataclass(frozen=True)
class _Drives:
    """Which cars on which tracks, and on what they are driven."""

    seeds: range
    tracks: list[str]
    out: Path
    processes: int
    scheduler: str

    def laps(self, laps: int, car: Path | None, without: bool) -> dict[str, Any]:
        """Summary of laps."""
        from benchmarks.campaign.laps import summarise, trials

        return summarise(self._all(trials(self.seeds, self.tracks, laps, car, without=without)))

    def through(self, events: Path) -> dict[str, Any]:
        """Summary of drives through events."""
        from benchmarks.campaign.events import read_cases, summarise, trials

        return summarise(self._all(trials(self.seeds, self.tracks, read_cases(events))))

    def _all(self, jobs: list[Job]) -> list[dict[str, Any]]:
        from benchmarks.campaign.run import Machines, drive_all

        return drive_all(jobs, self.out, Machines(self.processes, self.scheduler))


def _describe(summary: dict[str, Any]) -> list[str]:
    """A line a car, then the medians."""
    rows = [
        f"car {car['seed']} on {car['track']}: limit {figure(car['limit_s'], 's')}, ratio "
        f"{' '.join(f'{ratio:.3f}' for ratio in car['lap_ratio'])}; off track {car['off_track']}, "
        f"spins {car['spins']}, beyond the peak at most {figure(car['friction_over_s'], 's')}"
        for car in summary["cars"]
    ]
    missing = f"laps not driven: {summary['laps_missing']}"
    medians = ", ".join(f"lap {lap}: {ratio:.3f}" for lap, ratio in summary["median_ratio"].items())
    return [*rows, f"median ratio: {medians}", missing]


def _describe_cases(summary: dict[str, Any]) -> list[str]:
    """A line a case, cars that left the road last."""
    rows = [
        f"{name}: {case['drives']} drives, left the road {case['off_track']}, spun {case['spun']}, stopped "
        f"{case['stopped']}, least margin {figure(case['worst_margin_m'], 'm')}, lost at most "
        f"{figure(case['most_lost_m'], 'm')}"
        for name, case in summary["cases"].items()
    ]
    left = [f"car {d['seed']} on {d['track']}, {d['case']}" for d in summary["drives"] if d["off_track"]]
    return [*rows, f"left the road: {'; '.join(left) or 'none'}"]
