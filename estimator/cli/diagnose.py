"""`hil diagnose`: residual, missing effect, error before and after."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.offline.progress import approached
from hil_gateway.process.figures import figure, print_json
from hil_gateway.process.writable import check_folder

if TYPE_CHECKING:
    from estimator.drive_log.table import DriveLog
    from estimator.offline.health import HealthReport
    from estimator.offline.record.record import Record
    from hil_gateway.car.vehicle import Vehicle
    from hil_gateway.track.track import Track

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)

RESULTS = ("report.html", "diagnosis.json", "model.json")
"""what `--out` holds afterwards"""
SHARES = {
    "reading": 0.0, "log health": 0.03, "windows": 0.05, "lateral motion": 0.07, "road": 0.1,
    "last steps of the fit": 0.92, "scoring on the test laps": 0.93, "writing the report": 0.94,
}  # fmt: skip
"""Shares of the time of a diagnosis at which its parts begin; between the road and the last steps lies the search."""
LATERAL_END = 0.35
"""The same at the end of an identification of the lateral motion, where a log needs one."""
TYPICAL_STEPS = 120
"""Fits of a search after which half of it is done."""
SEARCHED = 0.7
"""Share of the seconds given after which no further round begins: the round under way, the last steps and the report
take the rest."""


def _print_effects(wanted: bool) -> None:
    """Print the catalogue and end."""
    if wanted:
        from estimator.model.catalogue_page import parameter_list

        print(parameter_list())
        raise typer.Exit


@app.command()
def diagnose(  # noqa: PLR0917 - every option of the command is a parameter
    sessions: Annotated[list[Path], typer.Argument(help="recorded .mcap or drive-log .csv files: one data set")],
    columns: Annotated[
        Path | None, typer.Option("--columns", help="map of the columns (TOML), as `hil session columns` proposes it")
    ] = None,
    vehicle: Annotated[Path | None, typer.Option(help="vehicle JSON; default: the car's")] = None,
    tyre: Annotated[Path | None, typer.Option(help="tyre prior JSON; default: the car's")] = None,
    track: Annotated[str | None, typer.Option(help="map whose bank and grade are known: file or shipped name")] = None,
    layout: Annotated[str, typer.Option(help="tyre parameters: per_axle or shared")] = "per_axle",
    out: Annotated[Path | None, typer.Option(help="folder for diagnosis.json, model.json and report.html")] = None,
    seconds: Annotated[
        float | None, typer.Option(min=1.0, help="end after about so long with what was found until then")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
    effects: Annotated[
        bool,
        typer.Option(
            "--effects", callback=_print_effects, is_eager=True, help="print the parameters of all effects and end"
        ),
    ] = False,
) -> None:
    """Find what the model does not explain, trace it to an effect, and show the error before and after."""
    # fits run in processes side by side: threads of the linear algebra would only get in their way
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from estimator.drive_log.column_map import read_map
    from estimator.drive_log.table import read_logs
    from estimator.offline import simulated_lateral
    from estimator.offline.diagnosis import diagnose as run
    from estimator.offline.record.declared import read_tyre_prior, read_vehicle
    from estimator.offline.report.diagnosis_result import as_json as to_json
    from estimator.offline.report.diagnosis_result import as_revision, write
    from estimator.offline.search.pool import workers
    from hil_gateway.process.errors import InputError
    from hil_gateway.session.files.configuration import recorded_car
    from hil_gateway.track.loading import load_track

    end_s = math.inf if seconds is None else time.monotonic() + SEARCHED * seconds
    if out is not None:
        check_folder(out, RESULTS, [path for path in (*sessions, vehicle, tyre) if path is not None])
    if layout not in ("per_axle", "shared"):
        raise InputError(f"--layout {layout}: must be per_axle or shared")
    recorded = recorded_car(sessions)
    car = read_vehicle(vehicle, recorded)
    prior = read_tyre_prior(tyre, layout, car, recorded)  # type: ignore[arg-type]
    known = None if track is None else (track, load_track(track))
    with _progress() as bar, workers(os.cpu_count() or 1) as pool:
        progress = DiagnosisProgress(bar)
        progress("reading")
        logged = read_logs(sessions, None if columns is None else read_map(columns))
        record, log, health = _examined(logged, car, known, progress)
        progress("lateral motion")
        lateral = simulated_lateral.identified_laterally(logged, record, car, prior, layout, progress.lateral)  # type: ignore[arg-type]
        if lateral is not None:
            prior, log = simulated_lateral.lateral_prior(lateral, prior), simulated_lateral.repaired_log(lateral)
            record = _record(log, car, health, known)
        result = run(record, layout, prior, progress, pool, over=lambda: time.monotonic() > end_s)  # type: ignore[arg-type]
        revision = as_revision(result, layout, tuple(log.sources.values()))
        if result.cut_short:
            print(f"hil: the search ended after {seconds:g} s: what it found until then is given", file=sys.stderr)
        examined = health if lateral is None else lateral.health
        summary: dict[str, Any] = {"health": [finding.description for finding in examined.findings]}
        summary |= to_json(result, revision.revision, "" if out is None else str(out / "report.html"))
        if lateral is not None:
            summary = simulated_lateral.with_simulated_lateral(summary, lateral)
        if out is not None:
            progress("writing the report")
            from estimator.offline.report.diagnosis_report import write_report

            write(summary, revision, out)
            write_report(result, summary, log, out / "report.html", progress)
    if as_json:
        print_json(summary)
    else:
        _print(summary)


class DiagnosisProgress:
    """Tells a progress bar how far a diagnosis is, by the names of its parts and the number of steps in them."""

    def __init__(self, bar: Callable[[str, float], None]) -> None:
        """`bar` is told what is done and the share that is behind."""
        self._bar, self._part, self._steps, self._reached = bar, 0.0, 0, 0.0

    def __call__(self, what: str) -> None:
        """Say what is done next: a part of `SHARES`, or a step of the present one."""
        self._steps += 1
        if what in SHARES:
            self._part, self._steps = max(SHARES[what], self._reached), 0
        self._bar(what, approached(self._part, self._end, self._steps, TYPICAL_STEPS))

    def lateral(self, what: str, share: float) -> None:
        """Say what the identification of the lateral motion does next, and the share of it that is behind."""
        self._reached = self._part + (LATERAL_END - self._part) * share
        self._bar(what, self._reached)

    @property
    def _end(self) -> float:
        return min((share for share in SHARES.values() if share > self._part), default=1.0)


def _examined(
    log: DriveLog, car: Vehicle, known: tuple[str, Track] | None, progress: Callable[[str], None]
) -> tuple[Record, DriveLog, HealthReport]:
    """What is fitted, the log it comes from, and the defects found in that; `known`: name and map of the track."""
    from estimator.offline.health import examine

    progress("log health")
    health = examine(log, car)
    progress("windows")
    return _record(health.log, car, health, known), health.log, health


def _record(log: DriveLog, car: Vehicle, health: HealthReport, known: tuple[str, Track] | None) -> Record:
    """The repaired `log` ready to be explained."""
    from estimator.offline.record.map_road import record_on_map
    from estimator.offline.record.record import make_record

    record = make_record(log, car, health.doubtful, vy_displaced=health.vy_is_displaced)
    return record if known is None else record_on_map(record, log, known[1], known[0])


@contextmanager
def _progress() -> Iterator[Any]:
    """Progress bar on standard error that says which candidate is being tried; silent where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (BarColumn(20), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda what, share: bar.update(task, description=what, completed=share)


def _print(summary: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from estimator.offline.report.words import verdict_sentence

    console = Console(file=sys.stdout)
    console.print(verdict_sentence(summary), soft_wrap=True)
    table = Table("channel", "declared", "re-fitted", "with effects", "noise floor", box=None)
    for channel, values in summary["channels"].items():
        table.add_row(channel, *(figure(values[k]) for k in ("declared", "refit", "with_effects", "noise_floor")))
    console.print(table)
    if "lateral" in summary:
        console.print(f"- {summary['lateral']}", soft_wrap=True)
    for entry in summary["unexplained"]:
        console.print(f"- {entry['description']}", soft_wrap=True)
