"""`hil campaign learn`: driving to learn against driving normally, over many cars."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil_gateway.errors import EXIT_FAILURE, InputError

if TYPE_CHECKING:
    from planner.campaign import CampaignSettings, Trial

app = typer.Typer(no_args_is_help=True, help="Long comparisons over seeds.")


@app.callback()
def _group() -> None:
    """Long comparisons over seeds."""


@app.command()
def learn(  # noqa: PLR0917  (one argument a flag)
    seeds: Annotated[int, typer.Option(min=2, help="cars, each with other tyres")] = 20,
    laps: Annotated[int, typer.Option(min=1, help="laps of every drive")] = 1,
    track: Annotated[str, typer.Option(help="track file or name of a shipped track")] = "",
    methods: Annotated[str, typer.Option(help="ways of driving, comma-separated; plain is always among them")]
    = "infomax,plain,prbs,sine",
    weight: Annotated[float | None, typer.Option(help="q_I of Eq. (9) for infomax")] = None,
    criterion: Annotated[str | None, typer.Option(help="information criterion: trace | log_det")] = None,
    out: Annotated[Path, typer.Option(help="folder of trials and report; trials in it are not driven again")]
    = Path("campaign-learn"),
    processes: Annotated[int, typer.Option(min=1, help="drives at a time")] = os.cpu_count() or 1,
    scheduler: Annotated[str, typer.Option(help="address of a dask scheduler to drive on; empty: this machine")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="summary as one JSON object")] = False,
) -> None:  # fmt: skip
    """Samples and laps until the tyres are known: infomax against plain and two excited baselines.

    Resumable: interrupted, the same command goes on where it stopped.
    """
    from planner.campaign import CampaignSettings, Trial

    default = CampaignSettings()
    settings = replace(
        default, laps=laps, track=track,
        information_weight=default.information_weight if weight is None else weight,
        information_criterion=criterion or default.information_criterion,
    )  # fmt: skip
    trials = [Trial(method, seed) for seed in range(seeds) for method in _methods(methods)]
    results = _drive_all(trials, settings, out, processes, scheduler)
    summary = _conclude(results, out)
    if as_json:
        print(json.dumps(summary))
    else:
        _print(summary)
    if any(sum(m["violations"].values()) for m in summary["methods"].values()):
        raise SystemExit(EXIT_FAILURE)


def _methods(text: str) -> tuple[str, ...]:
    from planner.campaign import METHODS

    names = {name.strip() for name in text.split(",")} | {"plain"}
    if unknown := sorted(names - set(METHODS)):
        raise InputError(f"--methods {unknown[0]}: unknown way of driving; known: {', '.join(METHODS)}")
    return tuple(m for m in METHODS if m in names)


def _drive_all(
    trials: Sequence[Trial], settings: CampaignSettings, out: Path, processes: int, scheduler: str
) -> list[dict[str, Any]]:
    """All results, from the folder or driven now."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from planner.campaign import load, save

    found = {trial: load(out, trial, settings) for trial in trials}
    missing = [trial for trial, result in found.items() if result is None]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=sys.stderr)) as progress:
        task = progress.add_task("driving", total=len(trials), completed=len(trials) - len(missing))
        for trial, result in _run(missing, settings, processes, scheduler):
            save(out, result)
            found[trial] = result
            progress.update(task, advance=1, description=f"driven {trial.name}")
    return [result for result in found.values() if result is not None]


def _run(
    trials: Sequence[Trial], settings: CampaignSettings, processes: int, scheduler: str
) -> Iterator[tuple[Trial, dict[str, Any]]]:
    """Results as they finish, from worker processes of this machine or of a dask cluster."""
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    from planner.campaign import run_trial

    if scheduler:
        yield from _run_on_cluster(trials, settings, scheduler)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run_trial, trial, settings): trial for trial in trials}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _run_on_cluster(
    trials: Sequence[Trial], settings: CampaignSettings, scheduler: str
) -> Iterator[tuple[Trial, dict[str, Any]]]:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError("--scheduler needs dask: pip install 'hil-gateway[cluster]'") from None
    from planner.campaign import run_trial

    with Client(scheduler) as client:
        futures = {client.submit(run_trial, trial, settings, pure=False): trial for trial in trials}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _conclude(results: Sequence[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Summary and report beside the trials."""
    from planner.campaign_analysis import drives_of, summarise
    from planner.campaign_report import write_report

    drives = drives_of(results)
    summary = summarise(drives)
    summary["report"] = str(write_report(drives, summary, out / "report.html"))
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    return summary


def _print(summary: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from planner.campaign_report import interval

    table = Table(title=f"Learning campaign, {summary['seeds']} cars: median (95 % interval)")
    for column in ("way of driving", "target", "samples", "laps", "times fewer than plain", "reached"):
        table.add_column(column)
    for method, m in summary["methods"].items():
        for target, t in m["targets"].items():
            table.add_row(method, target, interval(t["samples"], 0), interval(t["laps"]),
                          interval(t["fewer_than_plain"]), str(t["reached"]))  # fmt: skip
    console = Console()
    console.print(table)
    for method, m in summary["methods"].items():
        console.print(
            f"{method}: lap time lost {interval(m['lap_time_lost_percent'])} %, off track {m['violations']['track']}, "
            f"over load limit {m['violations']['load']}, traction lost {m['violations']['traction']}, "
            f"failed plans {m['plan_failures']}"
        )
    console.print(f"report: {summary['report']}")
