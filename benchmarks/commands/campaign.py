"""`hil campaign`: `learn` (infomax), `diagnose` (effects of the simulated car), `closed` (drive, diagnose, drive),
`laps` (lap times of cars nobody has driven, over their own limit), `cars` (named cars that nothing may stop), `explore`
(how soon the limit is known), `places` (driving off from anywhere), `soak` (everything lost in turn, for a night)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from benchmarks.commands.campaign_cars import cars
from benchmarks.commands.campaign_closed import closed
from benchmarks.commands.campaign_diagnose import RESULTS, diagnose
from benchmarks.commands.campaign_explore import explore
from benchmarks.commands.campaign_laps import laps as campaign_laps
from benchmarks.commands.campaign_places import places
from benchmarks.commands.campaign_soak import soak
from benchmarks.commands.options import CORES, AsJson, FirstSeed, LapsOfDrive, Methods, Processes, Scheduler, Track
from hil_gateway.config import PlannerConfig
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import figure, print_json
from hil_gateway.process.writable import check_folder

if TYPE_CHECKING:
    from benchmarks.campaign.trial import CampaignSettings, Learnt, Trial

CRITERIA = get_args(PlannerConfig.model_fields["information_criterion"].annotation)
app = typer.Typer(no_args_is_help=True, help="Long comparisons over seeds.")
app.command()(diagnose)
app.command()(closed)
app.command("laps")(campaign_laps)
app.command()(cars)
app.command()(places)
app.command()(explore)
app.command()(soak)


@app.callback()
def _group() -> None:
    """Long comparisons over seeds."""


@app.command()
def learn(  # noqa: PLR0917  (one argument a flag)
    seeds: Annotated[int, typer.Option(min=2, help="cars, each with other tyres")] = 20,
    laps: LapsOfDrive = 1,
    seconds: Annotated[float, typer.Option(min=0, help="end drives after so long, before the laps are done; 0: laps")]
    = 0.0,
    track: Track = "",
    methods: Methods = "infomax,plain,prbs,sine",
    weight: Annotated[float | None, typer.Option(help="q_I of Eq. (9) for infomax")] = None,
    criterion: Annotated[str | None, typer.Option(help="information criterion: trace | log_det")] = None,
    first_seed: FirstSeed = 0,
    afterwards: Annotated[int, typer.Option(min=0, help="cars that also drive with declared and with learnt model")]
    = 0,
    out: Annotated[Path, typer.Option(help="folder of trials and report; trials in it are not driven again")]
    = Path("campaign-learn"),
    processes: Processes = CORES,
    scheduler: Scheduler = "",
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Samples and laps until the tyres are known: infomax against plain and two excited baselines.

    Resumable: interrupted, the same command goes on where it stopped.
    """
    from benchmarks.campaign.run import Machines, drive_all
    from benchmarks.campaign.trial import job
    from hil_gateway.track.loading import load_track

    check_folder(out, RESULTS)
    settings = replace(_information(weight, criterion), laps=laps, seconds=seconds, track=track)
    length, machines = load_track(track).length, Machines(processes, scheduler)
    trials = _trials(range(first_seed, first_seed + seeds), _methods(methods))
    results = drive_all([job(trial, settings) for trial in trials], out, machines)
    after = [job(trial, settings, learnt) for trial, learnt in _afterwards(results, afterwards)]
    summary = _conclude(results, drive_all(after, out, machines), length, out)
    if as_json:
        print_json(summary)
    else:
        _print(summary)
    if any(sum(m["violations"].values()) for m in summary["methods"].values()):
        raise SystemExit(EXIT_FAILURE)


def _information(weight: float | None, criterion: str | None) -> CampaignSettings:
    """How infomax weighs information, as given or by default."""
    from benchmarks.campaign.trial import CampaignSettings

    if criterion not in (None, *CRITERIA):
        raise InputError(f"--criterion {criterion}: must be one of {', '.join(CRITERIA)}")
    default = CampaignSettings()
    return CampaignSettings(
        information_weight=default.information_weight if weight is None else weight,
        information_criterion=criterion or default.information_criterion,
    )


def _trials(cars: Sequence[int], methods: Sequence[str]) -> list[Trial]:
    """Every car driven in every way."""
    from benchmarks.campaign.trial import KNOWN, Trial

    return [Trial(method, seed) for seed in cars for method in (KNOWN, *methods)]


def _methods(text: str) -> tuple[str, ...]:
    from benchmarks.campaign.trial import METHODS

    names = {name.strip() for name in text.split(",")} | {"plain"}
    if unknown := sorted(names - set(METHODS)):
        raise InputError(f"--methods {unknown[0]}: unknown way of driving; known: {', '.join(METHODS)}")
    return tuple(m for m in METHODS if m in names)


def _afterwards(results: Sequence[dict[str, Any]], cars: int) -> list[tuple[Trial, Learnt | None]]:
    """Drives with the declared model and with what infomax learnt, for the first `cars` cars."""
    from benchmarks.campaign.after import learnt_by
    from benchmarks.campaign.trial import Trial

    learnt = {r["trial"]["seed"]: learnt_by(r) for r in results if r["trial"]["method"] == "infomax"}
    chosen = sorted(learnt)[:cars]
    return [job for s in chosen for job in ((Trial("prior", s), None), (Trial("learnt", s), learnt[s]))]


def _conclude(
    results: Sequence[dict[str, Any]], proofs: Sequence[dict[str, Any]], lap_length: float, out: Path
) -> dict[str, Any]:
    """Summary and report beside the trials."""
    from benchmarks.campaign.after import compare
    from benchmarks.campaign.analysis import drives_of, summarise
    from benchmarks.campaign.report import write_report

    drives = drives_of(results)
    summary = {**summarise(drives, lap_length), "afterwards": compare(proofs)}
    summary["report"] = str(write_report(drives, summary, out / "report.html"))
    (out / "summary.json").write_text(json.dumps(summary, indent=1))
    return summary


def _print(summary: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from benchmarks.campaign.report import interval

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
    if (after := summary["afterwards"]) is not None:
        console.print(
            f"afterwards: {interval(after['faster_percent'])} % faster with the learnt model, "
            f"least margin {figure(after['prior']['worst_margin_m'], digits=3)} -> "
            f"{figure(after['learnt']['worst_margin_m'], 'm', 3)}, "
            f"cars that left the track: {_left(after['left_the_track'])}"
        )
    console.print(f"report: {summary['report']}")


def _left(cars: dict[str, list[int]]) -> str:
    """Numbers of the cars, by the model they drove with."""
    return ", ".join(f"{figure(seeds)} with the {model} model" for model, seeds in cars.items())
