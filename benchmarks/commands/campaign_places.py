"""Command line of the campaign of places."""

from __future__ import annotations

import sys
from itertools import islice
from typing import Annotated

import typer

from benchmarks.commands.options import AsJson
from hil_gateway.process.errors import EXIT_FAILURE
from hil_gateway.process.figures import print_json


def places(
    count: Annotated[int, typer.Option("--places", min=1, help="places and headings")] = 1000,
    first_seed: Annotated[int, typer.Option(min=0, help="which row of places is drawn")] = 0,
    tracks: Annotated[str, typer.Option(help="comma-separated; empty: all that are shipped")] = "",
    as_json: AsJson = False,
) -> None:
    """Drive off from anywhere on road and pit lane. Exit 1 where an armed car stands and nothing says why."""
    from rich.console import Console
    from rich.progress import track as with_bar

    from benchmarks.campaign.places import drawn, trial
    from hil_gateway.track.loading import load_track, shipped_tracks

    names = [name.strip() for name in tracks.split(",") if name.strip()] or sorted(shipped_tracks())
    for name in names:
        load_track(name)
    chosen = list(islice(drawn(first_seed, names), count))
    outcomes = [trial(place) for place in with_bar(chosen, "places", console=Console(file=sys.stderr))]
    broken = [outcome for outcome in outcomes if not outcome.kept]
    moved = sum(outcome.moved_after_s is not None for outcome in outcomes)
    if as_json:
        print_json({"outcomes": [outcome.as_json() for outcome in outcomes], "moved": moved, "broken": len(broken),
                    "left_the_road": sum(outcome.left_the_road for outcome in outcomes)})  # fmt: skip
    else:
        print(f"{len(outcomes)} places: {moved} under way, {len(outcomes) - moved} with a reason or broken")
        print("\n".join(f"left the road: {outcome}" for outcome in outcomes if outcome.left_the_road))
        print("\n".join(f"broken: {outcome}" for outcome in broken))
    if broken:
        raise typer.Exit(EXIT_FAILURE)
