"""Command line of the soak."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.options import AsJson, Track
from hil_gateway.process.errors import EXIT_FAILURE
from hil_gateway.process.figures import print_json


def soak(  # noqa: PLR0917  (one argument a flag)
    hours: Annotated[float, typer.Option(min=0.01, help="how long")] = 8.0,
    seed: Annotated[int, typer.Option(min=0, help="which row of losses is drawn")] = 0,
    track: Track = "",
    step_clock: Annotated[bool, typer.Option("--step-clock", help="set this computer's clock too, and back (root)")]
    = False,
    out: Annotated[Path, typer.Option(help="folder of recordings and summary; on a small disk that is filled too")]
    = Path("campaign-soak"),
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Lose every process, the computer's sleep, its clock and its disk in turn, with real processes, for a night.

    Exit 1 where a loss does not end as docs/failsafe.md says, or the car does not drive again.
    """
    from benchmarks.driving import soak as night
    from benchmarks.driving.live_loop import LiveLoop

    outcomes = []
    with LiveLoop(out, track=track) as loop:
        loop.drive_off()
        memory = {"begin": loop.memory_mb()}
        for outcome in night.soak(loop, hours * 3600.0, seed, step_clock):
            outcomes.append(outcome)
            print(outcome, file=sys.stderr, flush=True)
        memory["end"] = loop.memory_mb()
    broken = [outcome for outcome in outcomes if outcome.broken]
    summary = {"losses": len(outcomes), "broken": len(broken), "left_the_road": sum(o.left_the_road for o in outcomes),
               "memory_mb": memory, "outcomes": [outcome.as_json() for outcome in outcomes]}  # fmt: skip
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    if as_json:
        print_json(summary)
    else:
        off = summary["left_the_road"]
        print(f"{len(outcomes)} losses, {len(broken)} not as docs/failsafe.md says, {off} off the road")
        print("\n".join(f"broken: {outcome}" for outcome in broken))
    if broken:
        raise typer.Exit(EXIT_FAILURE)
