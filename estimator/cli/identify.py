"""`hil identify`: tyre parameters from recorded drives, with the error before and after."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.cli.offline import (
    AsJson,
    Bar,
    Columns,
    Sessions,
    TyreFile,
    VehicleFile,
    check_results,
    progress_bar,
    read_data_set,
)
from hil_gateway.process.figures import figure, plain, print_json

if TYPE_CHECKING:
    from estimator.offline.identification import Identification, Options
    from estimator.offline.result.identification_score import LogScore

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


RESULTS = ("report.html", "identification.json", "tyre.json")
"""what `--out` holds afterwards"""


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


OneLayout = Annotated[LayoutName, typer.Option(help="one tyre for both axles, or one each")]
Method = Annotated[
    MethodName, typer.Option(help="batches of 100 samples, Eq. 8 per sample, or full nonlinear least squares")
]
Formulation = Annotated[FormulationName, typer.Option(help="forces against accelerations, or simulated windows")]
Window = Annotated[float, typer.Option(help="length of simulated windows, s", min=0.5, max=60.0)]
Keep = Annotated[list[str] | None, typer.Option(help="log-health finding to report but not act on")]
Scored = Annotated[list[Path] | None, typer.Option(help="another log to score the result on; may be repeated")]
Out = Annotated[Path | None, typer.Option(help="folder for identification.json, tyre.json and report.html")]


@app.command()
def identify(  # noqa: PLR0917 - every option of the command is a parameter
    sessions: Sessions,
    columns: Columns = None,
    vehicle: VehicleFile = None,
    tyre: TyreFile = None,
    layout: OneLayout = LayoutName.PER_AXLE,
    method: Method = MethodName.NLS,
    formulation: Formulation = FormulationName.AUTO,
    window: Window = 4.0,
    keep: Keep = None,
    score: Scored = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Identify the tyre parameters and say what the data can and cannot tell."""
    from estimator.offline.fit_and_repair import SCORED, Options

    check_results(out, RESULTS, [*sessions, *(score or ()), vehicle, tyre])
    options = Options(layout.value, method.value, formulation.value, window, frozenset(keep or ()))
    with progress_bar() as progress:
        result, scores = _identified((sessions, columns), (vehicle, tyre), score or [], options, progress)
        summary = _summary(result, scores)
        if out is not None:
            progress("report", SCORED)
            summary["report"] = str(_write(result, scores, summary, out))
    if as_json:
        print_json(summary)
    else:
        _print(result, scores, summary["not_exported"])


def _identified(
    data: tuple[list[Path], Path | None],
    declared: tuple[Path | None, Path | None],
    score: list[Path],
    options: Options,
    progress: Bar,
) -> tuple[Identification, dict[str, LogScore]]:
    """The result of `data` (logs, map of their columns) and its scores on the other logs by their names; `declared`:
    vehicle and tyre file."""
    from estimator.offline.identification import identify as run
    from estimator.offline.identification import score_log
    from estimator.offline.record.declared import read_tyre_prior, read_vehicle
    from hil_gateway.session.files.configuration import recorded_car

    recorded = recorded_car(data[0])
    car = read_vehicle(declared[0], recorded)
    prior = read_tyre_prior(declared[1], options.layout, car, recorded)
    progress("reading", 0.0)
    log, others = read_data_set(*data), {str(path): read_data_set([path], None) for path in score}
    result = run(log, car, prior, options, progress)
    return result, {path: score_log(result, other) for path, other in others.items()}


def _summary(result: Identification, scores: Mapping[str, LogScore]) -> dict[str, Any]:
    """What `--json` prints."""
    from estimator.offline.result.identification_score import as_summary
    from estimator.offline.tyre_export import exported, not_exported, usable_slip

    return {
        **result.summary(),
        "scored": {path: as_summary(one.rmse) for path, one in scores.items()},
        "scored_at_states": {path: as_summary(one.at_states) for path, one in scores.items()},
        "exported": exported(result),
        "usable_slip": usable_slip(result),
        "not_exported": not_exported(result),
    }


def _write(
    result: Identification,
    scores: Mapping[str, LogScore],
    summary: dict[str, Any],
    out: Path,
) -> Path:
    from estimator.offline.report.identification_report import write_report

    out.mkdir(parents=True, exist_ok=True)
    page, whole, tyre = (out / name for name in RESULTS)
    write_report(result, scores, page)
    whole.write_text(json.dumps(plain(summary), indent=1))
    tyre.write_text(json.dumps(plain(summary["exported"]), indent=1))
    return page


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
