"""Command line of the closed-loop campaign."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from benchmarks.commands.options import AsJson
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import print_json

DEFAULT = "aero_drag=1.2,steer_offset=0.005,combined_slip=1"


def closed(  # noqa: PLR0917  (one argument a flag)
    effects: Annotated[str, typer.Option(help="NAME=SIZE, comma-separated; every one is a case of its own")] = DEFAULT,
    base: Annotated[str, typer.Option(help="simulated car the effect is added to: paper or av24")] = "paper",
    track: Annotated[str, typer.Option(help="track file or name of a shipped track; empty: as configured")] = "",
    laps: Annotated[int, typer.Option(min=2, help="laps before and after the diagnosis")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="sensor noise of the first drive")] = 1,
    as_json: AsJson = False,
) -> None:
    """Drive with the declared model, diagnose, drive with what was found: error and lap time before and after.

    Kept: prediction error at most half, best lap no slower, nothing off the track. Exit 1 when a case is not kept.
    """
    from rich.console import Console
    from rich.progress import track as with_bar

    from benchmarks.campaign.closed import close_loop, describe
    from hil_gateway.demo.options import parse_effects
    from hil_gateway.plant.physics.effects import configure
    from hil_gateway.track.loading import load_track

    load_track(track)
    if base not in ("paper", "av24"):
        raise InputError(f"--base {base}: must be paper or av24")
    sizes = parse_effects([text.strip() for text in effects.split(",") if text.strip()])
    if not sizes:
        raise InputError(f"--effects {effects!r}: names no effect; write NAME=SIZE, comma-separated, as {DEFAULT}")
    configure(base, sizes)
    console = Console(file=sys.stderr)
    cases = [
        close_loop({name: size}, base, laps, seed, track)
        for name, size in with_bar(sizes.items(), "closing the loop", console=console)
    ]
    kept = sum(case.kept for case in cases)
    summary = {"cases": [case.as_json() for case in cases], "kept": kept}
    if as_json:
        print_json(summary)
    else:
        print("\n".join(describe(case) for case in cases))
    if kept < len(cases):
        raise typer.Exit(EXIT_FAILURE)
