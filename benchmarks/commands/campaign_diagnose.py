"""Command line of the diagnosis campaign."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.options import CORES, AsJson, Processes
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import lines, print_json
from hil_gateway.process.writable import check_folder

RESULTS = ("report.html", "summary.json")
"""what the folder of a campaign holds afterwards, besides the cases or trials"""


def diagnose(  # noqa: PLR0917  (one argument a flag)
    seeds: Annotated[int, typer.Option(min=1, help="drives of every effect")] = 10,
    effects: Annotated[str, typer.Option(help="comma-separated; `none` is the car as declared; empty: all")] = "",
    laps: Annotated[int, typer.Option(min=4, help="laps of every drive")] = 8,
    first_seed: Annotated[int, typer.Option(min=0, help="number of the first seed")] = 1,
    out: Annotated[Path, typer.Option(help="folder of cases and report; cases in it are not driven again")]
    = Path("campaign-diagnose"),
    processes: Processes = CORES,
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Every effect of the simulated car over seeds: what the diagnosis names, as a confusion matrix.

    Resumable: interrupted, the same command goes on where it stopped.
    """
    from rich.console import Console
    from rich.progress import track

    from benchmarks.campaign.diagnose import Case, percent, run_cases, summarise, write_report

    check_folder(out, RESULTS)
    cases = [Case(e, s) for s in range(first_seed, first_seed + seeds) for e in _names(effects)]
    console = Console(file=sys.stderr)
    results = list(track(run_cases(cases, laps, out, processes), "diagnosing", total=len(cases), console=console))
    summary = summarise(results)
    summary["report"] = str(write_report(results, summary, out / "report.html"))
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    if as_json:
        print_json(summary)
        return
    shares = {key: percent(summary[key]) for key in ("named_first", "nothing_but_the_truth", "false_alarms")}
    print("\n".join(lines({**shares, "report": summary["report"]})))


def _names(text: str) -> tuple[str, ...]:
    from benchmarks.campaign.diagnose import NONE
    from hil_gateway.plant.physics.effects import SWITCHES

    known = (NONE, *SWITCHES)
    names = tuple(n.strip() for n in text.split(",") if n.strip()) or known
    if unknown := sorted(set(names) - set(known)):
        raise InputError(f"--effects {unknown[0]}: unknown effect; known: {', '.join(known)}")
    return names
