"""Command line of the exploring campaign."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmarks.commands.options import CORES, AsJson, FirstSeed, LapsOfDrive, Methods, Processes, Scheduler, Track
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import figure, print_json
from hil_gateway.process.writable import check_folder

if TYPE_CHECKING:
    from benchmarks.campaign.explore import ExploreTrial


def explore(  # noqa: PLR0917  (one argument a flag)
    cars: Annotated[int, typer.Option(min=2, help="random cars, each driven in every way")] = 6,
    first_seed: FirstSeed = 0,
    laps: LapsOfDrive = 2,
    track: Track = "",
    methods: Methods = "infomax,plain,prbs,sine",
    scheduler: Scheduler = "",
    processes: Processes = CORES,
    out: Annotated[Path, typer.Option(help="folder of trials; trials in it are not driven again")]
    = Path("campaign-explore"),
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """How soon a car's own limit is known and driven: infomax against plain and two added signals, on realistic cars.

    Resumable: interrupted, the same command goes on where it stopped. Exit 1 when a car leaves the road or spins.
    """
    from benchmarks.campaign.explore import summarise
    from benchmarks.campaign.run import Machines, drive_all
    from hil_gateway.track.loading import load_track

    check_folder(out, ("summary.json",))
    load_track(track)
    jobs = [trial.job() for trial in _trials(range(first_seed, first_seed + cars), methods, track, laps)]
    summary = summarise(drive_all(jobs, out, Machines(processes, scheduler)))
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    if as_json:
        print_json(summary)
    else:
        print("\n".join(f"{method}: {_describe(m)}" for method, m in summary["methods"].items()))
    if any(m["off_track"] or m["spins"] for m in summary["methods"].values()):
        raise typer.Exit(EXIT_FAILURE)


def _trials(seeds: range, text: str, track: str, laps: int) -> list[ExploreTrial]:
    from benchmarks.campaign.explore import ExploreTrial
    from benchmarks.campaign.trial import METHODS

    names = {name.strip() for name in text.split(",")} | {"plain"}
    if unknown := sorted(names - set(METHODS)):
        raise InputError(f"--methods {unknown[0]}: unknown way of driving; known: {', '.join(METHODS)}")
    return [ExploreTrial(m, seed, track, laps) for seed in seeds for m in METHODS if m in names]


def _describe(m: dict[str, Any]) -> str:
    sooner, time = m["times_sooner_than_plain"], m["first_laps_over_plain"]
    return (
        f"limit known after {figure(m['known_after_s']['median'], 's', 3)} ({m['known']} of {m['cars']} cars), "
        f"{sooner['median']:.2f} ({sooner['low']:.2f} to {sooner['high']:.2f}) times sooner than plain; "
        f"time of the laps {time['median']:.3f} ({time['low']:.3f} to {time['high']:.3f}) of plain's; "
        f"off track {m['off_track']}, spins {m['spins']}, beyond the peak at most {figure(m['friction_over_s'], 's')}, "
        f"failsafes {m['failsafes']}"
    )
