"""Unit slips and sign conventions: channels that must agree up to a known factor.

Each pair measures one motion twice; the slope between them says whether one is in degrees, km/h or of opposite sign.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.derived import derivative
from estimator.drive_log.table import DriveLog
from estimator.offline.health.finding import Action, LogFinding
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

DEGREES = float(np.degrees(1.0))
KMH = 3.6
FACTORS = {
    "is in degrees, not rad": DEGREES,
    "is in km/h, not m/s": KMH,
    "has the opposite sign": -1.0,
    "is in degrees and has the opposite sign": -DEGREES,
}
NEAR = 0.25
"""A slope within this relative distance of a factor is taken for it."""

MIN_CORRELATION = 0.6


@dataclass(frozen=True)
class _Pair:
    """`channel` should equal `expected` (n,), made of other channels."""

    channel: str
    expected: Array
    against: str
    allowed: tuple[str, ...]


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Channels off by a known factor against most of what others say of the same motion.

    Channels are taken in turn, each judged with those before it already converted.
    """
    findings: list[LogFinding] = []
    for channel in ("vx", "yaw_rate", "ay", "steer", "ax", *WHEELS):
        finding = _judge(log, [pair for pair in _pairs(log, vehicle) if pair.channel == channel])
        if finding is not None and finding.repair is not None:
            log = finding.repair(log)
            findings.append(finding)
    return [*findings, *_percent(log)]


def _judge(log: DriveLog, pairs: list[_Pair]) -> LogFinding | None:
    """The finding more than half of the pairs agree on."""
    moving = log["vx"] > moving_speed(log)
    found = [finding for pair in pairs if (finding := _compare(log, pair, moving)) is not None]
    return found[0] if 2 * len(found) > len(pairs) else None


WHEELS = ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr")


def _pairs(log: DriveLog, vehicle: Vehicle) -> Iterator[_Pair]:
    degrees = ("is in degrees, not rad", "has the opposite sign", "is in degrees and has the opposite sign")
    speed = np.maximum(log["vx"], 1.0)
    if {"x", "y"} <= log.columns.keys():
        ground = np.hypot(derivative(log["t"], log["x"], log.segment), derivative(log["t"], log["y"], log.segment))
        yield _Pair("vx", ground, "the speed over ground from x and y", ("is in km/h, not m/s",))
    if "yaw" in log:
        heading = derivative(log["t"], np.unwrap(log["yaw"]), log.segment)
        yield _Pair("yaw_rate", heading, "d/dt yaw", degrees)
    yield _Pair("yaw_rate", log["steer"] * speed / vehicle.wheelbase, "what the steering implies", degrees)
    if "ay" not in log.derived:
        yield _Pair("yaw_rate", log["ay"] / speed, "ay / vx", degrees)
        yield _Pair("ay", log["vx"] * log["yaw_rate"], "vx yaw_rate", ("has the opposite sign",))
    yield _Pair("steer", log["yaw_rate"] * vehicle.wheelbase / speed, "the curvature driven", degrees)
    if "ax" not in log.derived:
        forward = derivative(log["t"], log["vx"], log.segment) - log["vy"] * log["yaw_rate"]
        yield _Pair("ax", forward, "d/dt vx", ("has the opposite sign",))
    for name in WHEELS:
        if name in log:
            yield _Pair(name, log["vx"], "vx", ("is in km/h, not m/s",))


def _compare(log: DriveLog, pair: _Pair, moving: NDArray[np.bool_]) -> LogFinding | None:
    values, expected = log[pair.channel][moving], pair.expected[moving]
    usable = np.abs(expected) <= np.quantile(np.abs(expected), 0.98)
    if np.var(values[usable]) == 0.0 or np.var(expected[usable]) == 0.0:  # constant, or too small to be squared
        return None
    correlation = float(np.corrcoef(values[usable], expected[usable])[0, 1])
    if abs(correlation) < MIN_CORRELATION:
        return None
    slope = float(np.sign(correlation)) * float(np.median(np.abs(values[usable])) / np.median(np.abs(expected[usable])))
    for what in pair.allowed:
        factor = FACTORS[what]
        tolerance = 2.0 if factor == -1.0 or pair.channel == "steer" else 1.0 + NEAR
        if slope * factor > 0 and 1.0 / tolerance < slope / factor < tolerance:
            return _finding(pair, what, factor, slope, abs(correlation))
    return None


def _finding(pair: _Pair, what: str, factor: float, slope: float, correlation: float) -> LogFinding:
    name = pair.channel

    def repair(log: DriveLog) -> DriveLog:
        return log.with_columns({name: log[name] / factor}, f"{name} divided by {factor:.4g}: it {what}")

    text = f"{name} {what}: {slope:.3g} times {pair.against}"
    return LogFinding(f"unit_{name}", name, text, slope, 0.0, "1", correlation, Action.CONVERTED, repair)


def _percent(log: DriveLog) -> list[LogFinding]:
    findings = []
    if "throttle" in log and 1.5 < float(log["throttle"].max()) <= 101.0:

        def repair(log: DriveLog) -> DriveLog:
            return log.with_columns({"throttle": 0.01 * log["throttle"]}, "throttle divided by 100: it is in percent")

        text = f"throttle is in percent, not 0..1: its maximum is {log['throttle'].max():.3g}"
        findings.append(
            LogFinding(
                "unit_throttle", "throttle", text, float(log["throttle"].max()), 0.0, "1", 1.0, Action.CONVERTED, repair
            )
        )
    return findings
