"""The learning campaign as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaign.analysis import HEADLINE, TARGETS, Drive, lap_time_lost_percent, samples_to_targets
from estimator.offline.report.page import ReportPage
from hil_gateway.dashboard.look import COLOURS, new_figure, plot_style
from hil_gateway.process.arrays import Array
from hil_gateway.process.figures import compared

COLOUR = {
    "infomax": COLOURS["after"], "plain": COLOURS["before"], "prbs": COLOURS["accent"], "sine": COLOURS["extra"],
}  # fmt: skip
LABEL = {"infomax": "infomax MPCC", "plain": "plain MPCC", "prbs": "plain + PRBS steering", "sine": "plain + sine"}

SHORT = {
    "d_10_percent": "known to 10 %", "d_5_percent": "known to 5 %", "d_3_percent": "known to 3 %", "rmse": "RMSE",
    "learnt": "5 % and RMSE",
}  # fmt: skip
assert set(SHORT) == set(TARGETS)


def write_report(drives: Sequence[Drive], summary: dict[str, Any], path: Path) -> Path:
    """Write the page."""
    methods = [m for m in LABEL if m in summary["methods"]]
    report = ReportPage("Learning campaign", f"{summary['seeds']} cars, closed loop on the simulated car")
    _verdict(report, summary)
    with plot_style():
        report.section(
            "How fast the tyres become known", "Median over cars, band from the 25th to the 75th percentile."
        )
        report.figure(_curves(drives, methods), "Left: information in the belief. "
                      "Right: error of what it predicts of a lap at the limits of the true tyres.")  # fmt: skip
        report.section("Samples to the targets", "Paired by car: how many times fewer samples than plain driving.")
        report.figure(_ratios(drives, methods), "One dot a car; the bar is the median. Above 1 is fewer samples.")
        _table(report, summary, methods)
        report.section("What learning costs, and whether it stayed safe")
        report.figure(
            _lost(drives, methods, summary["lap_length_m"]),
            "Time over the distance that both drove, against plain driving from the same standing start. One dot a "
            "car; the bar is the median.",
        )
    _safety(report, summary, methods)
    if summary["afterwards"] is not None:
        _afterwards(report, summary["afterwards"])
    report.section("How it was done")
    report.items([f"{name}: {text}" for name, text in summary["targets"].items()])
    report.items([
        "Every car has other tyres: each of B, C, D of either axle is off the declared value by the same share, up or "
        "down at random. All ways of driving meet the same cars.",
        "Samples are 100 Hz vehicle states driven since arming. A drive that does not reach a target counts in full.",
        "Off track is judged by the simulated car's referee; over load limit is more than 1.05 of the run's limit by "
        "the true tyres, and in a column of its own by those believed in; traction is lost when a true tyre slips "
        "beyond its own peak.",
        "Intervals are 95 % bootstrap percentiles of the median over cars.",
    ])  # fmt: skip
    return report.write(path)


def interval(value: dict[str, float] | None, digits: int = 2) -> str:
    """Median with its interval, for tables."""
    if value is None or not np.isfinite(value["median"]):
        return "-"
    return f"{value['median']:.{digits}f} ({value['low']:.{digits}f} to {value['high']:.{digits}f})"


def _verdict(report: ReportPage, summary: dict[str, Any]) -> None:
    infomax = summary["methods"].get("infomax")
    if infomax is None:
        return
    gain, lost = infomax["targets"][HEADLINE]["fewer_than_plain"], infomax["lap_time_lost_percent"]
    violations = sum(infomax["violations"].values())
    good = gain["median"] >= 2.0 and violations == 0 and lost["median"] <= 3.0
    report.verdict(
        f"Driving to learn knows the tyres with {compared(gain['median'], 'fewer', 'more')} samples "
        f"{'as' if compared(gain['median'], '', '') == 'as many' else 'than'} plain driving, "
        f"at {lost['median']:+.1f} % lap time and {violations} violations.",
        "good" if good else "warn",
    )


def _curves(drives: Sequence[Drive], methods: Sequence[str]) -> Any:
    figure, (left, right) = new_figure(1, 2, (10.0, 3.6))
    for method in methods:
        own = [d for d in drives if d.method == method]
        grid = np.linspace(1.0, min(d.seconds for d in own), 200)
        _band(left, grid, [np.interp(grid, d.t, d.log_det) for d in own], method)
        _band(right, grid, [np.interp(grid, d.rmse_t, d.rmse) for d in own], method)
    left.set(xlabel="driven, s", ylabel="log det of information", title="D-criterion of the belief")
    right.axhline(float(np.median([d.floor for d in drives])), color=COLOURS["muted"], ls="--", label="true tyres")
    right.set(xlabel="driven, s", ylabel="m/s²", title="Held-out RMSE of lateral acceleration", yscale="log")
    left.legend()
    right.legend()
    return figure


def _band(axes: Any, grid: Array, curves: list[Array], method: str) -> None:
    low, middle, high = np.percentile(curves, [25, 50, 75], axis=0)
    axes.fill_between(grid, low, high, color=COLOUR[method], alpha=0.15, lw=0)
    axes.plot(grid, middle, color=COLOUR[method], label=LABEL[method])


def _ratios(drives: Sequence[Drive], methods: Sequence[str]) -> Any:
    table = samples_to_targets(drives)
    figure, panels = new_figure(1, len(table), (10.0, 3.2), sharey=True)
    others = [m for m in methods if m != "plain"]
    for axes, (target, by_method) in zip(panels, table.items(), strict=True):
        for i, method in enumerate(others):
            seeds = sorted(by_method[method])
            ratios = [by_method["plain"][s][0] / max(by_method[method][s][0], 1.0) for s in seeds]
            spread = np.linspace(-0.15, 0.15, len(seeds))
            axes.plot(i + spread, ratios, "o", ms=3.5, color=COLOUR[method], alpha=0.6)
            axes.hlines(np.median(ratios), i - 0.25, i + 0.25, color=COLOUR[method], lw=2.5)
        axes.axhline(1.0, color=COLOURS["muted"], lw=1)
        axes.set(xticks=range(len(others)), xticklabels=others, title=SHORT[target], yscale="log")
        axes.set_yticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
        axes.minorticks_off()
        axes.set_xlim(-0.6, len(others) - 0.4)
    panels[0].set_ylabel("times fewer samples than plain")
    return figure


def _lost(drives: Sequence[Drive], methods: Sequence[str], lap_length: float) -> Any:
    plain = {d.seed: d for d in drives if d.method == "plain"}
    others = [m for m in methods if m != "plain"]
    figure, axes = new_figure(1, 1, (10.0, 2.6))
    for i, method in enumerate(others):
        lost = [lap_time_lost_percent(d, plain[d.seed], lap_length) for d in drives if d.method == method]
        axes.plot(lost, i + np.linspace(-0.15, 0.15, len(lost)), "o", ms=3.5, alpha=0.6, color=COLOUR[method])
        axes.vlines(np.median(lost), i - 0.3, i + 0.3, color=COLOUR[method], lw=2.5)
    axes.axvline(0.0, color=COLOURS["muted"], lw=1)
    axes.set(yticks=range(len(others)), yticklabels=[LABEL[m] for m in others], xlabel="time lost, % of a lap")
    axes.set_ylim(len(others) - 0.4, -0.6)
    return figure


def _table(report: ReportPage, summary: dict[str, Any], methods: Sequence[str]) -> None:
    rows = []
    for method in methods:
        m = summary["methods"][method]
        for target, t in m["targets"].items():
            reached = f"{t['reached']} of {summary['seeds']}"
            rows.append([f"{LABEL[method]}: {target.replace('_', ' ')}", interval(t["samples"], 0), interval(t["laps"]),
                         interval(t["fewer_than_plain"]), reached])  # fmt: skip
    report.table(["way of driving: target", "samples", "laps", "times fewer than plain", "cars that got there"], rows,
                 "Median over cars with its 95 % interval.")  # fmt: skip


def _safety(report: ReportPage, summary: dict[str, Any], methods: Sequence[str]) -> None:
    rows = []
    for method in methods:
        m = summary["methods"][method]
        rows.append([
            LABEL[method], interval(m["lap_time_lost_percent"]), str(m["violations"]["track"]),
            str(m["violations"]["load"]), str(m["violations"]["traction"]), f"{m['worst_true_load_share']:.2f}",
            str(m["load_by_model"]), f"{m['worst_margin_m']:.2f}",
            str(m["plan_failures"]), interval(m["parameter_error"], 3), interval(m["rmse_at_end"], 3),
        ])  # fmt: skip
    header = ["way of driving", "lap time lost, %", "off track", "over load limit", "traction lost", "true load share",
              "over load limit as believed", "least margin, m", "failed plans", "parameter error",
              "held-out RMSE, m/s²"]  # fmt: skip
    report.table(header, rows, "Off track and over the load limit: counts over all cars.")


def _afterwards(report: ReportPage, after: dict[str, Any]) -> None:
    report.section(
        "After learning",
        f"The plain planner, learning nothing more, on {after['seeds']} cars: with the declared model and with model, "
        f"belief and load limits that driving to learn ended with. Faster by {interval(after['faster_percent'])} %. "
        f"Left out, because they left the track with the declared model: {len(after['left_the_track']['prior'])} cars, "
        f"with the learnt one: {len(after['left_the_track']['learnt'])}.",
    )  # fmt: skip
    rows = [
        [name, interval(after[key]["lap_time_s"]), interval(after[key]["margin_m"]),
         f"{after[key]['worst_margin_m']:.2f}", f"{after[key]['worst_slip_share']:.2f}",
         *(str(n) for n in after[key]["violations"].values())]
        for key, name in (("prior", "declared model"), ("learnt", "learnt model"))
    ]  # fmt: skip
    header = ["model", "lap, s", "margin, m", "least margin, m", "slip over that of the peak", "off track",
              "over load limit", "traction lost"]  # fmt: skip
    report.table(header, rows, "Medians over cars; violations are counts over all cars.")
