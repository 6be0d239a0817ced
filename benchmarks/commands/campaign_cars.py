"""Command line of the campaign of named cars."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.commands.campaign_laps import TRACKS
from benchmarks.commands.options import CORES, AsJson, LapsOfDrive, Processes, Scheduler, Tracks
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import figure, print_json
from hil_gateway.process.writable import check_folder


def cars(  # noqa: PLR0917  (one argument a flag)
    cases: Annotated[Path, typer.Option(help='named cars (JSON): {"NAME": CAR FILE, ...}')],
    laps: LapsOfDrive = 2,
    tracks: Tracks = TRACKS,
    first: Annotated[int, typer.Option(min=0, help="number of the first car of the file to drive")] = 0,
    every: Annotated[int, typer.Option(min=1, help="from there, every car (1), every second (2), ...")] = 1,
    deal: Annotated[bool, typer.Option("--deal", help="each car on one of the tracks in turn, not on all")] = False,
    scheduler: Scheduler = "",
    processes: Processes = CORES,
    out: Annotated[Path, typer.Option(help="folder of trials; trials in it are not driven again")]
    = Path("campaign-cars"),
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Cars with nothing broken: no stop, no wheel off the road, all laps.

    `benchmarks/cases/effects.json` has every effect of the simulated car at its campaign size and mirrored,
    `effect_pairs.json` two of them at a time. Resumable: interrupted, the same command goes on where it stopped.
    Exit 1 when a car is stopped, leaves the road or does not drive its laps.
    """
    from benchmarks.campaign.cars import read_cars, summarise, trials
    from benchmarks.campaign.run import Machines, drive_all
    from hil_gateway.track.loading import load_track

    check_folder(out, ("summary.json",))
    names = [name.strip() for name in tracks.split(",") if name.strip()] or [""]
    for name in names:
        load_track(name)
    chosen = dict(islice(read_cars(cases).items(), first, None, every))
    if not chosen:
        raise InputError(f"--first {first}: {cases} has no car of that number; give a smaller one")
    jobs = trials(chosen, names, laps, deal=deal)
    summary = summarise(drive_all(jobs, out, Machines(processes, scheduler)))
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    if as_json:
        print_json(summary)
    else:
        print("\n".join(_describe(summary)))
    if summary["stopped"] or summary["left_the_road"] or summary["not_arrived"]:
        raise typer.Exit(EXIT_FAILURE)


def _describe(summary: dict[str, Any]) -> list[str]:
    """A line a drive that went wrong, then how many there are of each kind."""
    rows = [
        f"{drive['car']} on {drive['track']}: {len(drive['lap_times_s'])} laps, least margin "
        f"{figure(drive['worst_margin_m'], 'm')}{''.join(f', {t:.1f} s {cause}' for t, _, cause in drive['stopped'])}"
        for drive in summary["drives"]
        if drive["stopped"] or drive["off_track"] or not drive["arrived"]
    ]
    counts = f"stopped {summary['stopped']}, left the road {summary['left_the_road']}"
    return [*rows, f"{len(summary['drives'])} drives: {counts}, did not arrive {summary['not_arrived']}"]
