"""Command line of the lap campaign."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import figure, print_json
from hil_gateway.process.writable import check_folder

TRACKS = "road_course,oval,tri_oval"


def laps(  # noqa: PLR0917  (one argument a flag)
    cars: Annotated[int, typer.Option(min=1, help="cars, dealt out over the tracks in turn")] = 3,
    first_seed: Annotated[int, typer.Option(min=0, help="number of the first car")] = 0,
    laps: Annotated[int, typer.Option(min=1, help="laps of the first session")] = 10,
    tracks: Annotated[str, typer.Option(help="track files or names of shipped tracks, comma-separated")] = TRACKS,
    car: Annotated[Path | None, typer.Option(help="simulated car (JSON) in place of random ones")] = None,
    events: Annotated[
        Path | None, typer.Option(help="named lists of events (JSON): drive every car through each, instead of laps")
    ] = None,
    without: Annotated[
        bool, typer.Option("--without-learning/--only-learning", help="drive every car without learning too")
    ] = True,
    scheduler: Annotated[str, typer.Option(help="address of a dask scheduler to drive on; empty: this machine")] = "",
    processes: Annotated[int, typer.Option(min=1, help="drives at a time")] = os.cpu_count() or 1,
    out: Annotated[Path, typer.Option(help="folder of trials; trials in it are not driven again")]
    = Path("campaign-laps"),
    as_json: Annotated[bool, typer.Option("--json", help="summary as one JSON object")] = False,
) -> None:  # fmt: skip
    """Laps of cars nobody has driven over the limit of that very car, judged by the plant.

    Resumable: interrupted, the same command goes on where it stopped. Exit 1 when a car leaves the road, spins, does
    not drive all laps, or has an axle beyond the peak of its tyres for more than 0.2 s; with events when one leaves the
    road.
    """
    from benchmarks.campaign import events as through_events
    from benchmarks.campaign.laps import summarise, trials
    from benchmarks.campaign.run import Machines, drive_all
    from hil_gateway.track.loading import load_track

    check_folder(out, ("summary.json",))
    names = [name.strip() for name in tracks.split(",") if name.strip()] or [""]
    for name in names:
        load_track(name)
    seeds, machines = range(first_seed, first_seed + cars), Machines(processes, scheduler)
    if events is None:
        summary = summarise(drive_all(trials(seeds, names, laps, car, without=without), out, machines))
        failed = any(summary[key] for key in ("off_track", "spins", "slides", "laps_missing"))
    elif car is not None:
        raise InputError("--car with --events: a car file has events of its own; leave one of them out")
    else:
        jobs = through_events.trials(seeds, names, through_events.read_cases(events))
        summary = through_events.summarise(drive_all(jobs, out, machines))
        failed = any(case["off_track"] for case in summary["cases"].values())
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    if as_json:
        print_json(summary)
    else:
        print("\n".join(_describe(summary) if events is None else _describe_cases(summary)))
    if failed:
        raise typer.Exit(EXIT_FAILURE)


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
