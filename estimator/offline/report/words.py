"""Where, when and above which value something acts, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimator.model.basis import Basis
from estimator.offline.search.acceptance import BEYOND_NOISE
from estimator.offline.search.stretches.cells import Stretch
from hil_gateway.process.arrays import Array
from hil_gateway.process.figures import figure

UNITS = {
    "vx": "m/s", "ax": "m/s2", "ay": "m/s2", "yaw_rate": "rad/s", "vy": "m/s", "steer": "rad", "steer_rate": "rad/s",
    "drive": "slip", "drive_rate": "slip/s", "track_position": "m", "t": "s", "yaw": "rad", "engine_speed": "rad/s",
}  # fmt: skip
NAMES = {
    "vx": "speed", "ax": "longitudinal acceleration", "ay": "lateral acceleration", "yaw_rate": "yaw rate",
    "vy": "lateral velocity", "steer": "steering angle", "steer_rate": "steering rate", "drive": "drive command",
    "drive_rate": "rate of the drive command", "track_position": "track position", "t": "time", "yaw": "heading",
    "turn_direction": "turn direction (1 left, -1 right, 0 straight)",
}  # fmt: skip
CHANNEL_NAMES = {
    "ax": "longitudinal specific force", "ay": "lateral specific force", "yaw_acc": "yaw acceleration",
    "vx_dot": "d/dt vx", "vy_dot": "d/dt vy",
}  # fmt: skip


def describe(basis: Basis, values: Array, coefficients: Array) -> str:
    """Over which stretch of its signal a fitted term is active: where it deviates by half its largest deviation.

    What it deviates from is its middle value, over time its first one: a step has no middle.

    Args:
        basis: of the term; values: (n,) the signal as driven; coefficients: (basis.size,) fitted.
    """
    if basis.signal == "turn_direction":
        return _turns(basis, coefficients)
    low, high = np.quantile(values, (0.002, 0.998))
    at = np.linspace(low, high, 400)
    term = basis.matrix(at) @ coefficients
    middle = float(np.median(basis.matrix(values[:: max(1, len(values) // 5000)]) @ coefficients))
    rest = float(term[0]) if basis.signal == "t" else middle
    active = np.abs(term - rest) > 0.5 * np.max(np.abs(term - rest))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(int), [0]])))
    spans = [(at[a], at[min(b, len(at)) - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return span_words(basis.signal, spans[:3], float(low), float(high))


def _turns(basis: Basis, coefficients: Array) -> str:
    """Which of right turns, straights and left turns differ from the two others."""
    at = np.array([-1.0, 0.0, 1.0])
    term = basis.matrix(at) @ coefficients
    off = np.abs(term - np.median(term))
    words = np.array(["right turns", "straights", "left turns"])
    return " and ".join(words[off > 0.5 * off.max()]) if off.max() > 0 else "all turns"


TURNING = ("yaw_rate", "ay", "steer", "vy")
"""Signals that change sign with the turn."""
NEAR_STRAIGHT = (0.0, 0.02, 0.05, 0.1, 0.15)
"""Bounds of driving straight that are tried, as shares of what the signal reaches in turns."""
SAME_IN_ALL_TURNS = 0.95
"""Share of a term's variance that the turn direction must explain for it to be the cause."""


def follows_turn_direction(basis: Basis, values: Array, coefficients: Array) -> bool:
    """Whether a term over a signal that changes sign with the turn is the same in all turns of one direction."""
    if basis.signal not in TURNING:
        return False
    driven = values[:: max(1, len(values) // 5000)]
    term = basis.matrix(driven) @ coefficients
    reach = float(np.quantile(np.abs(driven), 0.95))
    left = min(
        _within((driven > a * reach).astype(int) - (driven < -b * reach), term)
        for a in NEAR_STRAIGHT for b in NEAR_STRAIGHT
    )  # fmt: skip
    return left < (1 - SAME_IN_ALL_TURNS) * float(np.var(term))


def _within(group: Array, values: Array) -> float:
    """Variance of the values within their groups."""
    return float(sum(np.sum((own - own.mean()) ** 2) for own in (values[group == g] for g in np.unique(group)))) / len(
        values
    )


def span_words(signal: str, spans: Sequence[tuple[float, float]], low: float, high: float) -> str:
    """'track position between 300 and 450 m': the spans of a signal that reaches from `low` to `high`."""
    unit, name = UNITS.get(signal, ""), NAMES.get(signal, signal)
    tolerance = 0.01 * (high - low)
    parts = []
    for a, b in spans:
        if a <= low + tolerance and b >= high - tolerance:
            parts.append("throughout")
        elif b >= high - tolerance:
            parts.append(f"{'after' if signal == 't' else 'above'} {figure(a, digits=3)} {unit}".strip())
        elif a <= low + tolerance:
            parts.append(f"{'before' if signal == 't' else 'below'} {figure(b, digits=3)} {unit}".strip())
        else:
            parts.append(f"between {figure(a, digits=3)} and {figure(b, digits=3)} {unit}".strip())
    return f"{name} {' and '.join(parts)}" if parts else name


def grip_words(stretch: Stretch, change: float, std: float) -> str:
    """'from s = 440 to 740 m, in laps 3 and 5, the grip of both axles is 26 +- 1 % lower'."""
    laps = "every lap" if stretch.every_lap else _lap_words(stretch.laps)
    size = (
        f"{figure(100 * abs(change), digits=2)} ± {figure(100 * std, digits=1)} % {'lower' if change < 0 else 'higher'}"
    )
    return f"from s = {stretch.start:.0f} to {stretch.end:.0f} m, in {laps}, the grip of both axles is {size}"


def _lap_words(laps: Sequence[int]) -> str:
    """'lap 3', 'laps 3 to 6' or 'laps 3, 5 and 6'."""
    if len(laps) == 1:
        return f"lap {laps[0]}"
    if laps[-1] - laps[0] == len(laps) - 1:
        return f"laps {laps[0]} {'and' if len(laps) == 2 else 'to'} {laps[-1]}"
    return f"laps {', '.join(map(str, laps[:-1]))} and {laps[-1]}"


def parameter_words(name: str, parameter: dict[str, float | str]) -> str:
    """'force 420 +- 2 N', or that the data do not determine it."""
    if not parameter["determined"]:
        return f"{name} undetermined"
    unit = "" if parameter["unit"] == "1" else f" {parameter['unit']}"
    return f"{name} {figure(float(parameter['value']))} ± {figure(float(parameter['std']), digits=2)}{unit}"


def effect_words(entry: dict[str, Any]) -> str:
    """'rolling_resistance (force 420 +- 2 N)', and what explains the drive as well in its place."""
    other = entry["not_told_from"]
    return f"{entry['name']} ({size_words(entry)})" + (f" or {other} in its place" if other else "")


def size_words(entry: dict[str, Any]) -> str:
    """'force 420 +- 2 N, pedal undetermined'"""
    return ", ".join(parameter_words(n, p) for n, p in entry["parameters"].items())


def verdict_sentence(summary: dict[str, Any]) -> str:
    """The result of a diagnosis in a sentence."""
    from estimator.model.effects import catalogue

    found = [effect_words(entry) for entry in summary["effects"]]
    insignificant = [f"{entry['name']} ({size_words(entry)})" for entry in summary["not_told"]]
    if summary["verdict"] == "none":
        return "The declared model, re-identified, explains this session down to its sensor noise: nothing is missing."
    wrong = [
        f"Declared {v['name']} {figure(v['declared'])}, found {figure(v['found'])} ± {figure(v['std'], digits=2)}."
        for v in summary["vehicle"]
    ]
    if summary["verdict"] == "effect":
        lacks = "; ".join(catalogue()[e["form"]].lacks for e in summary["effects"])
        return " ".join([*([f"The declared model lacks {' and '.join(found)}: {lacks}."] if found else []), *wrong])
    first, empirical = summary["unexplained"][0], summary["unexplained"][0]["empirical"]
    what = "Something outside the catalogue acts on" if empirical else "Not explained:"
    beside = f"Found: {', '.join(found)}." if found else ""
    not_told = f"Not told from nothing: {', '.join(insignificant)}." if insignificant else ""
    return " ".join(filter(None, (beside, explained_words(summary), f"{what} {first['description']}.", not_told)))


def explained_words(summary: dict[str, Any]) -> str:
    """How much of what the re-fitted model leaves beyond noise is explained, and what the rest costs."""
    shares = {name: _explained(row) for name, row in summary["channels"].items()}
    parts = [f"{100 * share:.0f} % in {CHANNEL_NAMES[name]}" for name, share in shares.items() if share is not None]
    explained = f"Of what is beyond noise it explains {', '.join(parts)}." if any(shares.values()) else ""
    return " ".join(filter(None, (explained, cost_words(summary))))


def cost_words(summary: dict[str, Any]) -> str:
    """Errors of prediction and of the lap time, those of the re-fitted model in brackets."""
    ahead = [_ahead_words(summary[name]) for name in ("rollout", "long_rollout")]
    words = f"Without measurements the model is off {'; '.join(ahead)}; re-fitted in brackets."
    if not (times := summary["lap_time_s"]):
        return words
    after, before = (times[name] - times["driven"] for name in ("with_effects", "refit"))
    return f"{words} A lap of {times['driven']:.1f} s takes {after:+.2f} s ({before:+.2f} s) by its forces."


def _ahead_words(rollout: Mapping[str, Any]) -> str:
    off = [
        f"{name} {figure(r['with_effects'], digits=2)} ({figure(r['refit'], digits=2)})"
        for name, r in rollout.items()
        if name != "horizon_s"
    ]
    return f"after {rollout['horizon_s']:g} s by {', '.join(off)}"


def _explained(channel: Mapping[str, float]) -> float | None:
    """Share of the excess variance of a channel that is explained; None where it has none."""
    floor = (BEYOND_NOISE * channel["noise_floor"]) ** 2
    excess = channel["refit"] ** 2 - floor
    left = channel["with_effects"] ** 2 - floor
    return None if excess <= 0.0 else min(1.0, max(0.0, 1.0 - left / excess))
