"""The identification report: one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from estimator.offline.identification import Identification
from estimator.offline.report import plots
from estimator.offline.report.page import ReportPage
from estimator.offline.result.identification_score import LogScore, Scores
from hil_gateway.car.tyre_names import label
from hil_gateway.dashboard.look import plot_style
from hil_gateway.process.figures import figure

UNITS = {"ax": "m/s2", "ay": "m/s2", "yaw_acc": "rad/s2", "vy": "m/s", "yaw_rate": "rad/s"}

WORSE = 1.01
"""an error that has grown by more than this is said"""


def write_report(result: Identification, scores: Mapping[str, LogScore], path: Path) -> Path:
    """Write the page of `result`, with its `scores` on other logs by their path, and return its path."""
    report = ReportPage("Tyre identification", _subtitle(result))
    with plot_style():
        _headline(report, result)
        _parameters(report, result)
        _predictions(report, result)
        _other_logs(report, scores)
        _what_is_known(report, result)
        _health(report, result)
    _provenance(report, result)
    return report.write(path)


def _subtitle(result: Identification) -> str:
    names = ", ".join(Path(source).name for source in result.log.sources) or "drive log"
    hours = len(result.log) * result.log.step
    return f"{names}: {hours:.0f} s at {1 / result.log.step:.0f} Hz, {result.split.kind}"


def _headline(report: ReportPage, result: Identification) -> None:
    unknown = [n for n, known in result.identifiability.identifiable.items() if not known]
    before, after = result.rmse["ay"]
    sentence = f"Lateral error on data not fitted goes {_change(before, after)} from {before:.3g} to {after:.3g} m/s2. "
    sentence += _worse(result)
    sentence += f"Not determined by this data: {', '.join(unknown)}." if unknown else "All parameters are determined."
    report.verdict(sentence, "warn" if unknown or _worse(result) else "good")
    report.tiles(
        [
            (f"{c} held out", f"{final:.3g}", f"{UNITS[c]}, {_change(initial, final)} from {initial:.3g}")
            for c, (initial, final) in result.rmse.items()
        ]
    )


def _change(initial: float, final: float) -> str:
    return "up" if final > initial else "down"


def _worse(result: Identification) -> str:
    """The channels whose error has grown, in a sentence; empty where none has."""
    grown = [(c, a, b) for c, (a, b) in result.rmse.items() if b > WORSE * a]
    if not grown:
        return ""
    return "Worse than before: " + ", ".join(f"{c} from {a:.3g} to {b:.3g} {UNITS[c]}" for c, a, b in grown) + ". "


def _parameters(report: ReportPage, result: Identification) -> None:
    report.section(
        "Parameters", "Initial and identified values; the standard deviation allows for correlated residuals."
    )
    rows = []
    for name, initial in result.initial.items():
        final, std = result.final[name], result.fit.std[name]
        known = "yes" if result.identifiability.identifiable[name] else "no"
        change = f"{100 * (final / initial - 1):+.2f} %"
        rows.append([label(name), f"{initial:.5g}", f"{final:.5g}", change, figure(std, digits=2), known])
    report.table(["Parameter", "Initial", "Final", "Change", "Std", "Identified"], rows)
    report.figure(plots.tyre_curves(result), _CURVES)
    extra = {p.name: p.unit for p in result.fit.parameters if p.name not in result.initial}
    report.table(
        ["Estimated along with them", "Unit", "Value", "Std"],
        [
            [label(n), unit, f"{result.fit.values[n]:.4g}", figure(float(result.fit.std[n]), digits=2)]
            for n, unit in extra.items()
        ],
    )


_CURVES = (
    "Lateral force over axle load against slip angle: before, after with its 95 % band, and where this data lies"
    " (grey: share of samples). Outside the grey the curve is extrapolated."
)


def _predictions(report: ReportPage, result: Identification) -> None:
    report.section("Predicted against measured", "Held-out data only: no fit has seen it.")
    report.figure(plots.time_histories(result), "Measured, and predicted before and after, over one held-out stretch.")
    report.figure(
        plots.learning_curve(result),
        "Held-out RMSE over the batches of 100 samples (or over samples), from the initial parameters: as published in"
        " section III of the paper, refined, and where the reported result stands.",
    )
    report.figure(
        plots.residual_spectra(result), "What remains, by frequency: a flat line is noise, a hump is physics."
    )


def score_lines(result: Identification, scores: Mapping[str, LogScore]) -> list[str]:
    """Every error before and after, simulated and at the measured states."""
    lines = [*_lines("held-out", result.rmse), *_at_states("held-out", result.rmse, result.rmse_at_states)]
    for path, one in scores.items():
        name = Path(path).name
        lines += [*_lines(name, one.rmse), *_at_states(name, one.rmse, one.at_states)]
    return lines


def _lines(what: str, rmse: Scores) -> list[str]:
    return [f"{what} RMSE {c:9s} {figure(before)} -> {figure(after, UNITS[c])}" for c, (before, after) in rmse.items()]


def _at_states(what: str, rmse: Scores, at_states: Scores) -> list[str]:
    """The errors at measured states where those in `rmse` are simulated."""
    return _lines(f"{what}, at measured states,", {c: v for c, v in at_states.items() if v != rmse[c]})


def _other_logs(report: ReportPage, scores: Mapping[str, LogScore]) -> None:
    if not scores:
        return
    report.section(
        "Scored on other logs",
        "Simulated: from the state at the start of each window. At measured states: the forces alone, m/s2 and rad/s2.",
    )
    rows = []
    for path, one in scores.items():
        for channel, (before, after) in one.rmse.items():
            there = one.at_states.get(channel)
            at_states = "" if there is None else f"{there[0]:.3g} to {there[1]:.3g}"
            rows.append([Path(path).name, f"{channel}, {UNITS[channel]}", f"{before:.3g} to {after:.3g}", at_states])
    report.table(["Log", "Channel", "RMSE before to after", "At measured states"], rows)


def _what_is_known(report: ReportPage, result: Identification) -> None:
    known = result.identifiability
    report.section("What the data tells and what not", "Fisher information of the scaled tyre parameters, Eq. 6 and 7.")
    report.items(known.statements)
    report.table(
        ["Trace", "D: log det", "A: trace of inverse", "E: smallest eigenvalue", "Condition number"],
        [[f"{v:.4g}" for v in (known.trace, known.d_criterion, known.a_criterion, known.e_criterion)]
         + [f"{known.condition_number:.3g}"]],
    )  # fmt: skip
    report.figure(plots.correlations(result), "Correlation of the estimates, and relative standard deviation of each.")


def _health(report: ReportPage, result: Identification) -> None:
    report.section("Log health", "Defects found in the recording itself, and what was done about them.")
    if not result.health.findings:
        report.text("Nothing was found.")
        return
    rows = [
        [f.name, f.description, figure(f.size, f.unit, 3), f"{f.confidence:.2f}", str(f.action)]
        for f in result.health.findings
    ]
    report.table(["Finding", "What", "Size", "Confidence", "Action"], rows, "Switch one off with --keep NAME.")


def _provenance(report: ReportPage, result: Identification) -> None:
    report.section("Provenance")
    report.made_with(result.vehicle)
    report.items(
        [
            f"layout {result.options.layout}, method {result.options.method}, formulation {result.formulation}",
            f"{len(result.log)} rows, {len(result.samples)} samples used, {result.seconds:.1f} s",
        ]
    )
    report.details("Notes on the data", [*result.log.notes, *result.notes])
    report.details("Files", [f"{path}  sha256 {digest}" for path, digest in result.log.sources.items()])
