"""Whether what a diagnosis states is true as often as it says, over practice drives drawn at random.

    python -P benchmarks/calibration.py --drives 60 --first 0 --out DIR

A drive has none to three effects of sensible size on one car, a road course or an oval, 4 to 8 laps and 25 to 200 rows
a second, all drawn from its number (course, laps and rate for twelve drives together). Of what is stated: how often the
95 % intervals of sizes and tyre parameters hold the truth, how often a name is of an effect that is not there, and how
often a name of a given confidence is right; with 95 % intervals (Clopper and Pearson 1934), in `DIR/calibration.json`
and `DIR/report.html`.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta, norm

from estimator.offline.report.page import COLOURS, Report, new_figure

sys.path.append(str(Path(__file__).parent))
from diagnose import FACTORS, MAIN, NEEDS_ANOTHER, PROFILE_RMS, Case, Wanted, drives, line, row, run
from practice import SIZES, draw_size
from practice.car import TYRE

ROOT = 8100
"""of all draws; nothing is tuned on these drives"""
EFFECTS = tuple(name for name in MAIN if name in SIZES) + tuple(FACTORS)
"""of the catalogue, in its own form, with a size that a diagnosis states"""
HOW_MANY = (0.2, 0.4, 0.3, 0.1)
"""probabilities of none to three effects"""
LAPS = (4, 9)
RATES_HZ = (25.0, 50.0, 100.0, 200.0)
BOUND = float(norm.ppf(0.975))
SIDE_BY_SIDE = 12
"""drives of one course, number of laps and rate: to simulate many takes as long as to simulate one"""
CONFIDENCES = (0.0, 0.9, 0.99, 1.0)
"""ends of the ranges of confidence that are judged apart"""


@dataclass(frozen=True)
class Share:
    """`hits` of `count`, with the 95 % interval of the probability behind it."""

    hits: int
    count: int

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


def drawn(number: int) -> Wanted:
    """The drive of this number."""
    rng = np.random.default_rng([ROOT, number])
    names = [str(n) for n in rng.choice(EFFECTS, size=rng.choice(len(HOW_MANY), p=HOW_MANY), replace=False)]
    effects = {name: draw_size(name, rng) for name in names}
    for name in names:
        effects = NEEDS_ANOTHER.get(name, {}) | effects
    alike = np.random.default_rng([ROOT, number // SIDE_BY_SIDE, 1])
    course, laps, rate = alike.choice(["road", "oval"]), int(alike.integers(*LAPS)), float(alike.choice(RATES_HZ))
    return Wanted(effects, ROOT * 1000 + number, course=str(course), laps=laps, rate_hz=rate)


def deviations(case: Case) -> dict[str, float]:
    """What is stated -> (stated less true) over the stated standard deviation: sizes of effects that are there, and
    tyre parameters, where all that is there was found."""
    found = {e["name"]: e["parameters"] for e in case.result["effects"]}
    sizes = {}
    for name, size in case.effects.items():
        parameter = found.get(name, {}).get(MAIN.get(name) or FACTORS[name])
        if parameter is not None and parameter["determined"]:
            true = 1.0 + size if name in FACTORS else size * PROFILE_RMS.get(name, 1.0)
            sizes[name] = (parameter["value"] - true) / parameter["std"]
    if set(found) != set(case.effects) or case.result["verdict"] == "unexplained":
        return sizes
    tyre = case.result["tyre"]
    return sizes | {n: (tyre[n]["value"] - true) / tyre[n]["std"] for n, true in TYRE.items() if n in tyre}


def names(case: Case) -> list[tuple[str, float, bool]]:
    """(name, confidence, whether it is there) of every effect named."""
    return [(e["name"], float(e["confidence"]), e["name"] in case.effects) for e in case.result["effects"]]


def summary(cases: Sequence[Case]) -> dict[str, Share]:
    """What was judged -> how often it held."""
    z = {number: deviations(case) for number, case in enumerate(cases)}
    of_sizes = [abs(d) < BOUND for each in z.values() for name, d in each.items() if name not in TYRE]
    of_tyres = [abs(d) < BOUND for each in z.values() for name, d in each.items() if name in TYRE]
    named = [entry for case in cases for entry in names(case)]
    right = {
        f"named with confidence {low:g} to {high:g}: it is there": [
            t for _, c, t in named if low <= c <= high and c != low
        ]
        for low, high in itertools.pairwise(CONFIDENCES)
    }
    told = {
        "95 % interval of a size holds the truth": of_sizes,
        "95 % interval of a tyre parameter holds the truth": of_tyres,
        "a name is of an effect that is not there": [not there for _, _, there in named],
        "a drive with such a name": [any(not there for _, _, there in names(case)) for case in cases],
        "all effects of a drive are named": [set(case.effects) <= set(case.named) for case in cases],
        **right,
    }
    return {what: Share(sum(flags), len(flags)) for what, flags in told.items()}


def by_parameter(cases: Sequence[Case]) -> dict[str, list[float]]:
    """Effect or tyre parameter -> its deviations, in standard deviations as stated."""
    gathered: dict[str, list[float]] = {}
    for case in cases:
        for name, deviation in deviations(case).items():
            gathered.setdefault(name, []).append(deviation)
    return dict(sorted(gathered.items()))


def write_report(cases: Sequence[Case], shares: dict[str, Share], path: Path) -> Path:
    """One page: shares, deviations against the normal distribution, and every parameter."""
    report = Report("Calibration of the diagnosis", f"{len(cases)} practice drives drawn at random, root {ROOT}")
    report.section("How often what is stated holds")
    report.table(["Stated", "How often (95 % interval)"], [[what, share.words()] for what, share in shares.items()])
    found = by_parameter(cases)
    report.section("Deviations from the truth", "In standard deviations as stated; honest ones lie on the line.")
    report.figure(_against_normal(found), "Share of deviations that are smaller, against the normal distribution.")
    rows = [[n, str(len(z)), f"{np.mean(z):+.2f}", f"{np.sqrt(np.mean(np.square(z))):.2f}", f"{max(map(abs, z)):.1f}"]
            for n, z in found.items()]  # fmt: skip
    report.table(["Parameter", "Stated", "Mean", "RMS", "Largest"], rows)
    return report.write(path)


def _against_normal(found: dict[str, list[float]]) -> Any:
    figure, (left, right) = new_figure(1, 2, (9.0, 3.2))
    groups = {"sizes of effects": (left, False), "tyre parameters": (right, True)}
    for title, (axis, tyres) in groups.items():
        z = np.sort(np.abs([d for name, each in found.items() if (name in TYRE) is tyres for d in each]))
        axis.plot(2 * norm.cdf(z) - 1, (np.arange(len(z)) + 0.5) / max(len(z), 1), color=COLOURS["after"])
        axis.plot([0, 1], [0, 1], color=COLOURS["measured"], linewidth=0.8, linestyle=":")
        axis.set(title=title, xlabel="as stated", xlim=(0, 1), ylim=(0, 1))
    left.set_ylabel("share of deviations")
    return figure


def cases_of(wanted: Sequence[Wanted], workers: int) -> Iterator[Case]:
    """Diagnosed in order, those of one course, number of laps and rate simulated side by side."""
    alike = sorted(wanted, key=lambda w: w.batch)
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(run, alike, drives(alike))


def main() -> None:
    """Run the drives and write the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("calibration"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    wanted = [drawn(number) for number in range(arguments.first, arguments.first + arguments.drives)]
    done: list[Case] = []
    for case in cases_of(wanted, arguments.workers):
        done.append(case)
        print(f"{len(done)}/{len(wanted)} {line(case)}", file=sys.stderr, flush=True)
        (arguments.out / "calibration.json").write_text(json.dumps([row(one) for one in done]))
    shares = summary(done)
    for what, share in shares.items():
        print(f"{what}: {share.words()}")
    print(write_report(done, shares, arguments.out / "report.html"))


if __name__ == "__main__":
    main()
