"""What calibration drives say: shares of intervals that hold, of names that are there, and a page.

A drive is plain data: `there` names what it has, `sizes` is "effect.parameter" -> true value, `tyre` the true tyre
parameters, `may` names what its car has without a size of its own, `result` is what `hil diagnose` says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta, norm

from estimator.offline.report.page import ReportPage
from hil_gateway.dashboard.look import COLOURS, new_figure

BOUND = float(norm.ppf(0.975))
CONFIDENCES = ((0.0, 0.9), (0.9, 0.99), (0.99, 1.0))
"""ranges of confidence that are judged apart"""

Drive = Mapping[str, Any]


@dataclass(frozen=True)
class Share:
    """`hits` of `count`, with the 95 % interval of the probability behind it."""

    hits: int
    count: int

    @classmethod
    def of(cls, flags: Sequence[bool]) -> Share:
        """The share of true ones."""
        return cls(sum(flags), len(flags))

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson."""
        low = beta.ppf(0.025, self.hits, self.count - self.hits + 1) if self.hits else 0.0
        high = beta.ppf(0.975, self.hits + 1, self.count - self.hits) if self.hits < self.count else 1.0
        return float(low), float(high)

    def words(self) -> str:
        """For a table."""
        if not self.count:
            return "none"
        low, high = self.interval
        return f"{self.hits} of {self.count}, {self.hits / self.count:.1%} ({low:.1%} to {high:.1%})"


@dataclass(frozen=True)
class Stated:
    """A value with its interval, beside the truth."""

    name: str
    value: float
    std: float
    true: float
    explained: bool
    """whether the verdict leaves nothing unexplained; else a size is no measurement"""
    of_tyre: bool = False

    @property
    def deviation(self) -> float:
        """In standard deviations as stated."""
        return (self.value - self.true) / self.std

    @property
    def holds(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return abs(self.deviation) < BOUND


def named(drive: Drive) -> list[str]:
    """Names of effects that the diagnosis gives."""
    return [effect["name"] for effect in drive["result"]["effects"]]


def false_names(drive: Drive) -> list[str]:
    """Those of them that the car has not."""
    return [name for name in named(drive) if name not in drive["there"] and name not in drive["may"]]


def explained(drive: Drive) -> bool:
    """Whether nothing is left unexplained."""
    return bool(drive["result"]["verdict"] != "unexplained")


def stated(drive: Drive) -> Iterator[Stated]:
    """Sizes of effects that are there, and tyre parameters where all that is there was found, and nothing else."""
    found = {
        f"{effect['name']}.{name}": p
        for effect in drive["result"]["effects"] for name, p in effect["parameters"].items() if p["determined"]
    }  # fmt: skip
    for key, true in drive["sizes"].items():
        if key in found:
            yield Stated(key, found[key]["value"], found[key]["std"], true, explained(drive))
    if set(named(drive)) == set(drive["there"]) and explained(drive):
        for name, true in drive["tyre"].items():
            p = drive["result"]["tyre"].get(name)
            if p is not None:
                yield Stated(name, p["value"], p["std"], true, True, of_tyre=True)


def summary(drives: Sequence[Drive]) -> dict[str, Share]:
    """What was judged -> how often it held."""
    values = [value for drive in drives for value in stated(drive)]
    sizes = [v for v in values if not v.of_tyre]
    names = [(e["confidence"], e["name"] not in false_names(d)) for d in drives for e in d["result"]["effects"]]
    told = {
        "95 % interval of a size holds the truth, nothing left": [v.holds for v in sizes if v.explained],
        "95 % interval of a size holds the truth, beside `unexplained`": [v.holds for v in sizes if not v.explained],
        "95 % interval of a tyre parameter holds the truth": [v.holds for v in values if v.of_tyre],
        "a name is of an effect that is not there": [not there for _, there in names],
        "a drive with such a name": [bool(false_names(drive)) for drive in drives],
        "all effects of a drive are named": [set(drive["there"]) <= set(named(drive)) for drive in drives],
        "nothing left where all are named": [
            explained(drive) for drive in drives if set(drive["there"]) <= set(named(drive))
        ],
    }
    for low, high in CONFIDENCES:
        of_range = [there for confidence, there in names if low <= confidence < high + (high == 1.0)]
        told[f"named with confidence {low:g} to {high:g}: it is there"] = of_range
    return {what: Share.of(flags) for what, flags in told.items()}


def by_parameter(drives: Sequence[Drive]) -> dict[str, list[float]]:
    """Effect or tyre parameter -> its deviations, in standard deviations as stated."""
    gathered: dict[str, list[float]] = {}
    for drive in drives:
        for value in stated(drive):
            gathered.setdefault(value.name, []).append(value.deviation)
    return dict(sorted(gathered.items()))


def write_report(drives: Sequence[Drive], subtitle: str, path: Path) -> Path:
    """One page: shares, deviations against the normal distribution, every parameter, and false names."""
    report = ReportPage("Calibration of the diagnosis", subtitle)
    report.section("How often what is stated holds")
    report.table(
        ["Stated", "How often (95 % interval)"], [[what, share.words()] for what, share in summary(drives).items()]
    )
    report.section("Deviations from the truth", "In standard deviations as stated; honest ones lie on the line.")
    report.figure(_against_normal(drives), "Share of deviations that are smaller, against the normal distribution.")
    rows = [
        [n, str(len(z)), f"{np.mean(z):+.2f}", f"{np.sqrt(np.mean(np.square(z))):.2f}", f"{max(map(abs, z)):.1f}"]
        for n, z in by_parameter(drives).items()
    ]
    report.table(["Parameter", "Stated", "Mean", "RMS", "Largest"], rows)
    wrong = [[d["label"], ", ".join(d["there"]) or "nothing", ", ".join(n)] for d in drives if (n := false_names(d))]
    report.section("Names that are not there", "" if wrong else "None.")
    if wrong:
        report.table(["Drive", "There", "Not there"], wrong)
    return report.write(path)


def _against_normal(drives: Sequence[Drive]) -> Any:
    figure, axes = new_figure(1, 2, (9.0, 3.2))
    for axis, title, tyres in zip(axes, ("sizes of effects", "tyre parameters"), (False, True), strict=True):
        z = np.sort([abs(v.deviation) for drive in drives for v in stated(drive) if v.of_tyre is tyres])
        axis.plot(2 * norm.cdf(z) - 1, (np.arange(len(z)) + 0.5) / max(len(z), 1), color=COLOURS["after"])
        axis.plot([0, 1], [0, 1], color=COLOURS["measured"], linewidth=0.8, linestyle=":")
        axis.set(title=title, xlabel="as stated", xlim=(0, 1), ylim=(0, 1))
    axes[0].set_ylabel("share of deviations")
    return figure
