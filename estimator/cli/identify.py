"""`hil identify`: tyre parameters from recorded drives, with the error before and after."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.offline.progress import approached
from hil_gateway.process.figures import figure, plain, print_json
from hil_gateway.process.writable import check_folder

if TYPE_CHECKING:
    from estimator.offline.identification import Identification
    from estimator.offline.result.identification_score import LogScore

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


RESULTS = ("report.html", "identification.json", "tyre.json")
"""what `--out` holds afterwards"""
TYPICAL_SECTIONS = 4
"""Sections of a report after which half of it is done."""


class LayoutName(StrEnum):
    """Tyre parameters of both axles together, or of each."""

    SHARED = "shared"
    PER_AXLE = "per_axle"


class MethodName(StrEnum):
    """How the parameters are estimated."""

    BATCH = "batch"
    SAMPLE = "sample"
    NLS = "nls"


class FormulationName(StrEnum):
    """What is compared with the data."""

    AUTO = "auto"
    ALGEBRAIC = "algebraic"
    OUTPUT_ERROR = "output_error"


@app.command()
def identify(  # noqa: PLR0917 - every option of the command is a parameter
    sessions: Annotated[list[Path], typer.Argument(help="recorded .mcap or drive-log .csv files: one data set")],
    columns: Annotated[
        Path | None, typer.Option("--columns", help="map of the columns (TOML), as `hil session columns` proposes it")
    ] = None,
    vehicle: Annotated[Path | None, typer.Option(help="vehicle JSON; default: the car's")] = None,
    tyre: Annotated[Path | None, typer.Option(help="tyre prior JSON; default: the car's")] = None,
    layout: Annotated[LayoutName, typer.Option(help="one tyre for both axles, or one each")] = LayoutName.PER_AXLE,
    method: Annotated[
        MethodName, typer.Option(help="batches of 100 samples, Eq. 8 per sample, or full nonlinear least squares")
    ] = MethodName.NLS,
    formulation: Annotated[
        FormulationName, typer.Option(help="forces against accelerations, or simulated windows")
    ] = FormulationName.AUTO,
    window: Annotated[float, typer.Option(help="length of simulated windows, s", min=0.5, max=60.0)] = 4.0,
    keep: Annotated[list[str] | None, typer.Option(help="log-health finding to report but not act on")] = None,
    score: Annotated[
        list[Path] | None, typer.Option(help="another log to score the result on; may be repeated")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder for identification.json, tyre.json and report.html")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Identify the tyre parameters and say what the data can and cannot tell."""
    from estimator.drive_log.column_map import read_map
    from estimator.drive_log.table import read_logs
    from estimator.offline.identification import SCORED, Options, score_log
    from estimator.offline.identification import identify as run
    from estimator.offline.record.declared import read_tyre_prior, read_vehicle
    from estimator.offline.result.identification_score import as_summary
    from estimator.offline.tyre_export import exported, not_exported, usable_slip
    from hil_gateway.session.files.configuration import recorded_car

    if out is not None:
        check_folder(out, RESULTS, [path for path in (*sessions, *(score or ()), vehicle, tyre) if path is not None])
    options = Options(layout.value, method.value, formulation.value, window, frozenset(keep or ()))
    recorded = recorded_car(sessions)
    car = read_vehicle(vehicle, recorded)
    prior = read_tyre_prior(tyre, layout.value, car, recorded)
    with _progress() as progress:
        progress("reading", 0.0)
        named = None if columns is None else read_map(columns)
        log, others = read_logs(sessions, named), {str(path): read_logs([path]) for path in score or ()}
        result = run(log, car, prior, options, progress)
        scores = {path: score_log(result, other) for path, other in others.items()}
        summary = {**result.summary(), "scored": {path: as_summary(one.rmse) for path, one in scores.items()}}
        summary |= {"scored_at_states": {path: as_summary(one.at_states) for path, one in scores.items()}}
        summary |= {"grip": {path: one.grip.summary() for path, one in scores.items()}}
        summary |= {"exported": exported(result), "usable_slip": usable_slip(result)}
        summary |= {"not_exported": not_exported(result)}
        if out is not None:
            sections = itertools.count()

            def told(title: str) -> None:
                progress(title, approached(SCORED, 1.0, next(sections), TYPICAL_SECTIONS))

            told("report")
            summary["report"] = str(_write(result, scores, summary, out, told))
    if as_json:
        print_json(summary)
    else:
        _print(result, scores, summary["not_exported"])


def _write(
    result: Identification,
    scores: Mapping[str, LogScore],
    summary: dict[str, Any],
    out: Path,
    told: Callable[[str], None],
) -> Path:
    from estimator.offline.report.identification_report import write_report

    out.mkdir(parents=True, exist_ok=True)
    page, whole, tyre = (out / name for name in RESULTS)
    write_report(result, scores, page, told)
    whole.write_text(json.dumps(plain(summary), indent=1))
    tyre.write_text(json.dumps(plain(summary["exported"]), indent=1))
    return page


class _progress:  # noqa: N801 - used like a function
    """Progress bar on standard error; silent where that is not a terminal."""

    def __enter__(self) -> Any:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn())
        console = Console(stderr=True)
        self._bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        task = self._bar.add_task("", total=1.0)
        self._bar.start()
        return lambda what, share: self._bar.update(task, description=what, completed=share)

    def __exit__(self, *exception: object) -> None:
        self._bar.stop()


def _print(result: Identification, scores: Mapping[str, LogScore], refused: Sequence[str]) -> None:
    from rich.console import Console
    from rich.table import Table

    from estimator.offline.report.identification_report import score_lines

    console = Console(file=sys.stdout)
    table = Table("parameter", "unit", "initial", "final", "change", "std", "identified", box=None)
    for parameter in result.columns.model.tyre_table:
        name, initial = parameter.name, result.initial[parameter.name]
        final, std = result.final[name], result.fit.std[name]
        change = f"{100 * (final / initial - 1):+.1f} %"
        known = "yes" if result.identifiability.identifiable[name] else "no"
        values = (figure(initial, digits=5), figure(final, digits=5), change, figure(std, digits=2))
        table.add_row(name, parameter.unit, *values, known)
    console.print(table)
    for line in score_lines(result, scores):
        console.print(line, soft_wrap=True)
    for line in (*refused, *(f.description for f in result.health.findings), *result.identifiability.statements):
        console.print(f"- {line}", soft_wrap=True)
