"""`hil diagnose`: residual, missing effect, error before and after."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.cli.offline import (
    AsJson,
    Columns,
    Sessions,
    TyreFile,
    VehicleFile,
    check_results,
    progress_bar,
    read_data_set,
)
from estimator.offline.progress import approached
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import figure, print_json

if TYPE_CHECKING:
    from estimator.drive_log.table import DriveLog
    from estimator.model.parameters import Layout
    from estimator.offline.diagnosis import Diagnosis
    from estimator.offline.health import HealthReport
    from estimator.offline.identification import Identification
    from estimator.offline.record.record import Record
    from estimator.offline.search.pool import Pool
    from hil_gateway.bus.messages import ModelRevision
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
        from estimator.model.catalogue_text import catalogue_text

        print(catalogue_text())
        raise typer.Exit


TrackName = Annotated[str | None, typer.Option(help="map whose bank and grade are known: file or shipped name")]
LayoutName = Annotated[str, typer.Option(help="tyre parameters: per_axle or shared")]
Out = Annotated[Path | None, typer.Option(help="folder for diagnosis.json, model.json and report.html")]
Seconds = Annotated[float | None, typer.Option(min=1.0, help="end after about so long with what was found until then")]
Catalogue = Annotated[
    bool,
    typer.Option(
        "--effects", callback=_print_effects, is_eager=True, help="print equations, parameters, sources of all and end"
    ),
]


@app.command()
def diagnose(  # noqa: PLR0917 - every option of the command is a parameter
    sessions: Sessions,
    columns: Columns = None,
    vehicle: VehicleFile = None,
    tyre: TyreFile = None,
    track: TrackName = None,
    layout: LayoutName = "per_axle",
    out: Out = None,
    seconds: Seconds = None,
    as_json: AsJson = False,
    effects: Catalogue = False,
) -> None:
    """Find what the model does not explain, trace it to an effect, and show the error before and after."""
    # fits run in processes side by side: threads of the linear algebra would only get in their way
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from estimator.offline.search.pool import workers

    check_results(out, RESULTS, [*sessions, vehicle, tyre])
    task = _read_task(sessions, (vehicle, tyre), layout, track, seconds)
    with progress_bar() as bar, workers(os.cpu_count() or 1) as pool:
        progress = DiagnosisProgress(bar)
        progress("reading")
        found = _find(task, read_data_set(sessions, columns), progress, pool)
        if found.diagnosis.cut_short:
            print(f"hil: the search ended after {seconds:g} s: what it found until then is given", file=sys.stderr)
        summary = _summary(found, layout, out)
        if out is not None:
            _write(found, summary, layout, out, progress)
    if as_json:
        print_json(summary)
    else:
        _print(summary)


@dataclass(frozen=True)
class _Task:
    """What a log is diagnosed with."""

    car: Vehicle
    prior: Mapping[str, float]
    """of the tyres"""
    layout: Layout
    road: tuple[str, Track] | None
    """name and map of the track"""
    end_s: float
    """of the monotonic clock, after which no further round begins"""


@dataclass(frozen=True)
class _Found:
    """A diagnosis with what it comes from."""

    diagnosis: Diagnosis
    log: DriveLog
    health: HealthReport
    lateral: Identification | None
    """of a log without a lateral sensor that can be used"""


def _read_task(
    sessions: list[Path],
    declared: tuple[Path | None, Path | None],
    layout: str,
    track: str | None,
    seconds: float | None,
) -> _Task:
    """The declared car (vehicle and tyre file, where given) and road.

    Raises:
        InputError: a file or name that is not usable.
    """
    from estimator.offline.record.declared import read_tyre_prior, read_vehicle
    from hil_gateway.session.files.configuration import recorded_car
    from hil_gateway.track.loading import load_track

    end_s = math.inf if seconds is None else time.monotonic() + SEARCHED * seconds
    if layout not in ("per_axle", "shared"):
        raise InputError(f"--layout {layout}: must be per_axle or shared")
    chosen: Layout = "shared" if layout == "shared" else "per_axle"
    recorded = recorded_car(sessions)
    car = read_vehicle(declared[0], recorded)
    prior = read_tyre_prior(declared[1], chosen, car, recorded)
    return _Task(car, prior, chosen, None if track is None else (track, load_track(track)), end_s)


def _find(task: _Task, logged: DriveLog, progress: DiagnosisProgress, pool: Pool | None) -> _Found:
    """Diagnose the log; where it has no accelerations, the lateral motion is identified first."""
    from estimator.offline import simulated_lateral
    from estimator.offline.diagnosis import diagnose as run

    record, log, health = _examined(logged, task.car, task.road, progress)
    progress("lateral motion")
    prior = task.prior
    lateral = simulated_lateral.identified_laterally(logged, record, task.car, prior, task.layout, progress.lateral)
    if lateral is not None:
        prior, log = simulated_lateral.lateral_prior(lateral, prior), simulated_lateral.repaired_log(lateral)
        record = _record(log, task.car, health, task.road)
    found = run(record, task.layout, prior, progress, pool, over=lambda: time.monotonic() > task.end_s)
    return _Found(found, log, health if lateral is None else lateral.health, lateral)


def _summary(found: _Found, layout: str, out: Path | None) -> dict[str, Any]:
    """What `--json` prints."""
    from estimator.offline.report.diagnosis_result import as_json as to_json
    from estimator.offline.simulated_lateral import with_simulated_lateral

    summary: dict[str, Any] = {"health": [finding.description for finding in found.health.findings]}
    revision = _revision(found, layout).revision
    summary |= to_json(found.diagnosis, revision, "" if out is None else str(out / "report.html"))
    return summary if found.lateral is None else with_simulated_lateral(summary, found.lateral)


def _write(found: _Found, summary: dict[str, Any], layout: str, out: Path, progress: DiagnosisProgress) -> None:
    from estimator.offline.report.diagnosis_report import write_report
    from estimator.offline.report.diagnosis_result import write

    progress("writing the report")
    write(summary, _revision(found, layout), out)
    write_report(found.diagnosis, summary, found.log, out / "report.html", progress)


def _revision(found: _Found, layout: str) -> ModelRevision:
    """The model found, with the files it comes from."""
    from estimator.offline.report.diagnosis_result import as_revision

    return as_revision(found.diagnosis, layout, tuple(found.log.sources.values()))


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
