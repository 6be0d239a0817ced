"""The page an engineer forwards: what is missing, how sure, and what it is worth on data nobody has touched."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.model.effects import catalogue
from estimator.model.single_track import CHANNELS
from estimator.offline.diagnosis import Diagnosis, alternatives
from estimator.offline.report.page import ReportPage, Tone
from estimator.offline.report.words import (
    CHANNEL_NAMES,
    NAMES,
    UNITS,
    size_words,
    verdict_sentence,
)
from estimator.offline.result.diagnosis_score import channel_residuals
from estimator.offline.result.leftover import BINS
from hil_gateway.car.tyre_names import label
from hil_gateway.dashboard.look import COLOURS, new_figure, plot_style
from hil_gateway.process.arrays import Array
from hil_gateway.process.figures import figure

MAP_POINTS = 6000
TONES: Mapping[str, Tone] = {"none": "good", "effect": "good", "unexplained": "warn"}


def write_report(
    diagnosis: Diagnosis,
    summary: dict[str, Any],
    log: DriveLog,
    path: Path,
    progress: Callable[[str], None] = lambda _: None,
) -> Path:
    """Write the self-contained page; `progress` hears the title of every section that begins."""
    report = ReportPage("What the model does not explain", ", ".join(Path(p).name for p in log.sources), progress)
    report.verdict(verdict_sentence(summary), TONES[summary["verdict"]])
    report.tiles(_tiles(summary))
    _before_after(report, summary)
    _causes(report, diagnosis, summary)
    _ranking(report, diagnosis, summary)
    _equation(report, summary)
    _provenance(report, diagnosis, summary, log)
    return report.write(path)


def _tiles(summary: dict[str, Any]) -> list[tuple[str, str, str]]:
    tiles = []
    for channel, values in summary["channels"].items():
        before, after, floor = values["refit"], values["with_effects"], values["noise_floor"]
        tiles.append((CHANNEL_NAMES[channel], f"{before:.3g} → {after:.3g}", f"noise floor {floor:.3g}"))
    return tiles


def _before_after(report: ReportPage, summary: dict[str, Any]) -> None:
    report.section(
        "Before and after",
        "RMS residual on laps that no fit and no choice has seen: the declared model with its prior tyre numbers, the "
        "same re-identified, and with what was found added and everything re-identified.",
    )
    with plot_style():
        figure, (left, right) = new_figure(1, 2, size=(10.0, 3.2), gridspec_kw={"width_ratios": [5, 3]})
        _bars(left, {CHANNEL_NAMES[c]: v for c, v in summary["channels"].items()}, floor=True)
        left.set_title("residual over its noise floor")
        rollout = {n: v for n, v in summary["rollout"].items() if n != "horizon_s"}
        _bars(right, {n: {**v, "noise_floor": 1.0} for n, v in rollout.items()}, floor=False)
        right.set_title(f"open-loop error after {summary['rollout']['horizon_s']:g} s")
        figure.legend(*left.get_legend_handles_labels(), ncols=3, loc="outside lower center")
    report.figure(figure, "Left: 1 is as good as the sensors allow. Right: m/s and rad/s. Logarithmic scale.")
    header = ["channel", "declared", "re-fitted", "catalogue effects", "with effects", "noise floor"]
    keys = ("declared", "refit", "catalogue", "with_effects", "noise_floor")
    rows = [[CHANNEL_NAMES[c], *(f"{v[k]:.4g}" for k in keys)] for c, v in summary["channels"].items()]
    report.table(header, rows, "m/s2, rad/s2. 'With effects' includes empirical terms, 'catalogue effects' does not.")


def _bars(axes: Any, groups: Mapping[str, Mapping[str, float]], floor: bool) -> None:
    kinds = {"declared": "muted", "refit": "before", "with_effects": "after"}
    at = np.arange(len(groups))
    for k, (kind, colour) in enumerate(kinds.items()):
        heights = [v[kind] / v["noise_floor"] for v in groups.values()]
        name = {"declared": "declared", "refit": "re-fitted", "with_effects": "with effects"}[kind]
        axes.bar(at + 0.27 * (k - 1), heights, 0.25, color=COLOURS[colour], label=name)
    if floor:
        axes.axhline(1.0, color=COLOURS["measured"], lw=0.8)
    axes.set_yscale("log")
    axes.set_xticks(at, [g.replace(" specific", "\nspecific") for g in groups], fontsize=8)


def _causes(report: ReportPage, diagnosis: Diagnosis, summary: dict[str, Any]) -> None:
    drawn = [(e["name"], e["channels"][0], catalogue()[e["form"]].cause) for e in summary["effects"]]
    drawn += [(u.get("term", u["channel"]), u["channel"], u["signal"]) for u in summary["unexplained"][:2]]
    if not drawn:
        return
    report.section("The residual and its cause", "Mean residual on the test laps, in bins of the signal it depends on.")
    before = channel_residuals(diagnosis.record, diagnosis.test_rows, *_numbers(diagnosis, "refit"))
    after = channel_residuals(diagnosis.record, diagnosis.test_rows, *_numbers(diagnosis, "with_effects"))
    for name, channel, signal in drawn:
        with plot_style():
            figure, (left, right) = new_figure(1, 2, size=(10.0, 3.4), gridspec_kw={"width_ratios": [5, 4]})
            _against(left, diagnosis, before[channel], after[channel], channel, signal)
            _on_map(right, diagnosis, before[channel], channel)
        report.figure(figure, f"{name}: left against {NAMES.get(signal, signal)}; right the re-fitted model's residual "
                              "where it occurs (along the lap where there is no map).")  # fmt: skip


def _numbers(diagnosis: Diagnosis, which: str) -> tuple[Any, Array]:
    chosen = diagnosis.models[which]
    return chosen.model, chosen.parameters


def _against(  # noqa: PLR0917 - what is drawn, and where
    axes: Any, diagnosis: Diagnosis, before: Any, after: Any, channel: str, signal: str
) -> None:
    for (rows, residual), colour, name in ((before, "before", "re-fitted"), (after, "after", "with effects")):
        values = diagnosis.record.signals[signal][rows]
        if signal == "yaw":
            values = np.mod(values, 2 * np.pi)
        edges = np.unique(np.quantile(values, np.linspace(0.002, 0.998, BINS + 1)))
        which = np.digitize(values, edges) - 1
        centres, means = [], []
        for b in range(len(edges) - 1):
            own = residual[which == b]
            if len(own) > 20:
                centres.append(values[which == b].mean())
                means.append(own.mean())
        axes.plot(centres, means, "o-", ms=3, color=COLOURS[colour], label=name)
    axes.axhline(0.0, color=COLOURS["measured"], lw=0.8)
    axes.set_xlabel(f"{NAMES.get(signal, signal)}, {UNITS.get(signal, '')}".rstrip(", "))
    axes.set_ylabel(f"{CHANNEL_NAMES[channel]}, {'rad' if channel == 'yaw_acc' else 'm'}/s2")
    axes.set_title("measured less predicted")
    axes.legend()


def _on_map(axes: Any, diagnosis: Diagnosis, residual: Any, channel: str) -> None:
    rows, values = residual
    width = max(1, round(0.5 / diagnosis.record.step))
    smooth = np.convolve(values, np.ones(width) / width, "same")
    thin = slice(None, None, max(1, len(rows) // MAP_POINTS))
    limit = float(np.quantile(np.abs(smooth), 0.98)) or 1.0
    signals = diagnosis.record.signals
    if "x" in signals and "y" in signals:
        x, y = signals["x"][rows][thin], signals["y"][rows][thin]
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
    else:
        x = signals["track_position" if diagnosis.record.has_laps else "t"][rows][thin]
        y = smooth[thin]
    points = axes.scatter(
        x, y, c=smooth[thin], cmap="RdBu_r", vmin=-limit, vmax=limit, s=3, linewidths=0, rasterized=True
    )
    axes.figure.colorbar(points, ax=axes, shrink=0.85)
    axes.grid(False)
    axes.set_title(f"{channel} along the lap, before")


def _ranking(report: ReportPage, diagnosis: Diagnosis, summary: dict[str, Any]) -> None:
    report.section(
        "What was tried",
        "Gain: held-out log-likelihood over the laps learnt from, every 30 s of them predicted by a fit to the rest.",
    )
    rows = []
    for entry in summary["effects"]:
        rows.append([
            entry["name"], "accepted", f"{diagnosis.gains[entry['form']].gain:,.0f}", f"{entry['confidence']:.3f}",
            size_words(entry),
        ])  # fmt: skip
        for other in alternatives(diagnosis.search, entry["form"])[:4]:
            effect = catalogue().get(other.name)
            why = "explains less of the same residual"
            rows.append([
                f"instead of {entry['name']}: {other.name}", why, f"{other.evidence.gain:,.0f}", "",
                effect.separated_by if effect else "",
            ])  # fmt: skip
    rows.extend([e["name"], "not told from nothing", "", "", size_words(e)] for e in summary["not_told"])
    last = [t for t in diagnosis.search.rounds[-1][:6] if t.name not in diagnosis.accepted]
    rows.extend([t.name, "tried last", f"{t.evidence.gain:,.0f}", "", ""] for t in last)
    for term in diagnosis.term_trials[:5]:
        state = "accepted, empirical" if term in diagnosis.terms else "empirical, not accepted"
        rows.append([term.label, state, f"{term.evidence.gain:,.0f}", "", ""])
    report.table(["candidate", "outcome", "gain", "confidence", "parameters, or what would tell it apart"], rows)


def _equation(report: ReportPage, summary: dict[str, Any]) -> None:
    report.section("The model now", "Added to Eq. (1)-(3) of the declared model:")
    lines = []
    for entry in summary["effects"]:
        effect = catalogue()[entry["form"]]
        numbers = size_words(entry)
        lines.append(f"{effect.name}: {effect.equation}, with {numbers}. Source: {effect.source}.")
    lines.extend(f"empirical: {u['description']} ({u['term']})" for u in summary["unexplained"] if u["empirical"])
    report.items(lines or ["nothing"])
    rows = [
        [label(name), figure(float(v["value"]), digits=5), figure(float(v["std"]), digits=2)]
        for name, v in summary["tyre"].items()
    ]
    report.table(["tyre parameter", "value", "std"], rows)


def _provenance(report: ReportPage, diagnosis: Diagnosis, summary: dict[str, Any], log: DriveLog) -> None:
    report.section("Data split and provenance")
    report.made_with(diagnosis.record.vehicle)
    spans = {k: ", ".join(f"{a:.0f}-{b:.0f} s" for a, b in summary["split"][k]) for k in ("train", "test")}
    files = [f"{Path(p).name}: SHA-256 {digest}" for p, digest in log.sources.items()]
    report.items([
        f"learnt from: {spans['train']}", f"scored on: {spans['test']}", summary["split"]["note"],
        f"rows: {summary['rows']:,}; channels: {', '.join(CHANNELS)}", f"model revision {summary['revision']}",
        *summary.get("health", ()), *([summary["lateral"]] if "lateral" in summary else []), *log.notes, *files,
    ])  # fmt: skip
