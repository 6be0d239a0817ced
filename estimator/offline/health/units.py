"""Units and signs of all channels together: the conversions that make every relation between them right, fewest first.

Each relation of the motion (d/dt vx and ax, vx yaw_rate and ay, the curvature driven and steered, positions, heading)
ties two or three channels by the factors that each is off by. One relation alone cannot say which channel is wrong;
all of them can: the factors are those of the largest posterior over a small set (km/h, mph, kn, degrees, g, signs),
where every conversion has a price. What no factor of the set explains is asked, not guessed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from can_dbc.units import UNITS as FACTORS
from estimator.drive_log.derived import derivative, smoothed
from estimator.drive_log.table import DriveLog
from estimator.model.parameters import STIFFNESS
from estimator.offline.health.finding import Action, LogFinding
from estimator.offline.health.regression import PARTS, jackknifed
from estimator.offline.health.steering import GENTLE_SHARE
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array

SPEEDS = {"m/s": 1.0, **{unit: 1.0 / FACTORS[unit].factor for unit in ("km/h", "mph", "kn")}}
ANGLES = {"rad": 1.0, "degrees": 1.0 / FACTORS["deg"].factor}
ACCELERATIONS = {"m/s2": 1.0, "g": 1.0 / GRAVITY}
SLIPS = {"slip": 1.0, "percent": 100.0}
UNITS: Mapping[str, Mapping[str, float]] = {
    "vx": SPEEDS, "yaw_rate": ANGLES, "ax": ACCELERATIONS, "ay": ACCELERATIONS, "steer": ANGLES, "yaw": ANGLES,
    "drive": SLIPS,
}  # fmt: skip
"""channel -> unit -> its numbers over those in SI"""
FORWARD = ("vx",)
"""What drives forward has no other sign."""
WHEELS = ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr")
SI = {
    "vx": "m/s",
    "vy": "m/s",
    "yaw_rate": "rad",
    "ax": "m/s2",
    "ay": "m/s2",
    "steer": "rad",
    "yaw": "rad",
    "drive": "slip",
}

MIN_CORRELATION = 0.6
"""Below, noise or lag hide what a relation says."""
TOLERANCE, LATERAL_TOLERANCE = 0.15, 0.3
"""Standard deviation of the logarithm of a relation on sound logs; a vy is often displaced or filtered besides."""
PRICE = 3.0
"""of a conversion, in log-likelihood: a unit and a sign are each wrong in one channel of twenty"""
WRONG_SIGN, WORST = 12.0, 12.0
"""Log-likelihood that a relation costs at most: by its sign, by its size."""
UNEXPLAINED, STEER_UNEXPLAINED, SIGMAS = math.log(2.2), math.log(1.45), 3.0
"""Largest factors that weak correlation and a steering that is a little off leave, and deviations; more is a unit that
nobody knows, or the ratio of a steering that nobody declared."""
LIMITS = {"vx": 150.0, "vy": 75.0, "yaw_rate": 12.0, "ax": 6.0 * GRAVITY, "ay": 6.0 * GRAVITY, "steer": 1.0}
"""What no car of any size does, SI: the fastest cars reach 150 m/s and 6 g, model cars turn with 12 rad/s"""
ALMOST_ALL = 0.995
"""of the samples: single ones may be glitches"""
SWAY_S = 2.0
TELLS, BETTER = 0.35, 0.5
"""Share of the rear slip that cornering must leave unexplained at most, and over that without a conversion, for vy."""


@dataclass(frozen=True)
class Relation:
    """`ratio` is the product of the factors of channels to their powers, where nothing else is wrong.

    `correlation` says how far it can be trusted; `tolerance` in logarithm.
    """

    text: str
    ratio: float
    powers: Mapping[str, int]
    correlation: float
    tolerance: float = TOLERANCE

    def left(self, factors: Mapping[str, float]) -> float:
        """Logarithm of what the factors do not explain; infinite with the wrong sign."""
        expected = reduce(lambda whole, one: whole * factors[one[0]] ** one[1], self.powers.items(), 1.0)
        return math.log(self.ratio / expected) if self.ratio * expected > 0 else math.inf


@dataclass(frozen=True)
class Choice:
    """What one channel is in: a unit and a sign, and the factor they come to."""

    unit: str
    sign: int
    factor: float
    price: float


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Conversions of the channels, and channels whose unit cannot be told."""
    relations = list(_relations(log, vehicle))
    chosen = most_probable(relations, _choices(vehicle))
    findings = _unexplained(relations, {name: choice.factor for name, choice in chosen.items()})
    unknown = {finding.channel for finding in findings}
    for channel, choice in chosen.items():
        if choice.price > 0 and channel not in unknown:
            finding = _converted(log, channel, choice, [r for r in relations if channel in r.powers])
            findings.append(finding)
            log = finding.repair(log) if finding.repair else log
    speed = chosen["vx"].unit if "vx" in chosen else SI["vx"]
    for finding in (
        *_of_vy(log, vehicle, speed),
        *_of_positions(log),
        *_of_heading(log),
        *_of_wheels(log, vehicle),
        *_percent(log),
    ):
        findings.append(finding)
        log = finding.repair(log) if finding.repair else log
    return [*findings, *_beyond(log)]


def _choices(vehicle: Vehicle) -> dict[str, list[Choice]]:
    """What each channel may be in; the steering wheel's angle where the vehicle declares its ratio."""
    every: dict[str, list[Choice]] = {}
    for channel, units in UNITS.items():
        known = dict(units)
        if channel == "steer" and "steering_ratio" in vehicle.model_fields_set:
            known |= {f"{unit} of the steering wheel": f * vehicle.steering_ratio for unit, f in ANGLES.items()}
        signs = (1,) if channel in FORWARD else (1, -1)
        every[channel] = [
            Choice(unit, sign, sign * f, PRICE * (f != 1.0) + PRICE * (sign < 0))
            for unit, f in known.items()
            for sign in signs
        ]
    return every


def most_probable(relations: list[Relation], choices: Mapping[str, list[Choice]]) -> dict[str, Choice]:
    """The choice for every channel of a relation with the least price and misfit together."""
    names = sorted({channel for relation in relations for channel in relation.powers})
    shape = tuple(len(choices[name]) for name in names)
    cost = np.zeros(shape)
    for axis, name in enumerate(names):
        cost += _along(axis, len(names), np.array([choice.price for choice in choices[name]]))
    for relation in relations:
        logs, signs = np.zeros(shape), np.ones(shape)
        for name, power in relation.powers.items():
            factors = _along(names.index(name), len(names), np.array([choice.factor for choice in choices[name]]))
            logs, signs = logs + power * np.log(np.abs(factors)), signs * np.sign(factors)
        misfit = 0.5 * ((math.log(abs(relation.ratio)) - logs) / relation.tolerance) ** 2
        cost += np.minimum(misfit, WORST) + WRONG_SIGN * (signs != np.sign(relation.ratio))
    best = np.unravel_index(int(np.argmin(cost)), shape) if names else ()
    return {name: choices[name][int(i)] for name, i in zip(names, best, strict=True)}


def _along(axis: int, count: int, values: Array) -> Array:
    return values.reshape([-1 if i == axis else 1 for i in range(count)])


def _relations(log: DriveLog, vehicle: Vehicle) -> Iterator[Relation]:
    """Every relation the log tells."""
    t, segment = log["t"], log.segment
    moving = log["vx"] > moving_speed(log)
    if not moving.any():
        return
    smooth = {n: smoothed(t, log[n], segment) for n in ("vx", "yaw_rate", "ax", "ay")}
    turning = smooth["vx"] * smooth["yaw_rate"]
    pairs = []
    if "ax" not in log.derived:
        pairs.append(("d/dt vx", smooth["ax"], derivative(t, log["vx"], segment), {"ax": 1, "vx": -1}))
    if "ay" not in log.derived:
        pairs.append(("vx yaw_rate", smooth["ay"], turning, {"ay": 1, "vx": -1, "yaw_rate": -1}))
    if {"x", "y"} <= log.columns.keys():
        ground = np.hypot(*(derivative(t, log[n], segment) for n in ("x", "y")))
        pairs.append(("the speed over ground", smooth["vx"], ground, {"vx": 1}))
    if "yaw" in log:
        wrap = math.pi if float(np.ptp(log["yaw"])) < 8.0 else 180.0
        heading = derivative(t, np.unwrap(log["yaw"], period=2.0 * wrap), segment)
        pairs.append(("d/dt yaw", smooth["yaw_rate"], heading, {"yaw_rate": 1, "yaw": -1}))
    found = [_relation(text, values[moving], expected[moving], powers) for text, values, expected, powers in pairs]
    yield from filter(None, (*found, _steered(log, vehicle, moving, smooth), _driven(log, vehicle, moving, smooth)))


def _driven(log: DriveLog, vehicle: Vehicle, moving: NDArray[np.bool_], smooth: Mapping[str, Array]) -> Relation | None:
    """ax over what the drive command makes of it with a middling tyre, as stiff along as across, on the rear axle."""
    if "drive" in log.derived:
        return None
    t, segment, derived = log["t"], log.segment, "ax" in log.derived
    forward = derivative(t, log["vx"], segment) if derived else smooth["ax"]
    stiffness = math.sqrt(math.prod(STIFFNESS)) * GRAVITY * vehicle.lf / vehicle.wheelbase
    expected = stiffness * smoothed(t, log["drive"], segment)
    powers, wide = {"drive": -1, "vx" if derived else "ax": 1}, 0.5 * math.log(STIFFNESS[1] / STIFFNESS[0])
    return _relation("the drive command", forward[moving], expected[moving], powers, wide)


def _steered(
    log: DriveLog, vehicle: Vehicle, moving: NDArray[np.bool_], smooth: Mapping[str, Array]
) -> Relation | None:
    """Steering over the angle of the path in gentle driving, beside what understeer and yaw acceleration add."""
    t, segment = log["t"], log.segment
    speed, rate = smooth["vx"], smooth["yaw_rate"]
    rows = moving & (np.abs(speed * rate) < GENTLE_SHARE * np.quantile(np.abs(speed * rate)[moving], 0.99))
    path, steer = (vehicle.wheelbase * rate / np.maximum(speed, 1e-6))[rows], smoothed(t, log["steer"], segment)[rows]
    if rows.sum() < 50 * PARTS or np.std(path) == 0.0 or np.std(steer) == 0.0:
        return None
    correlation = abs(float(np.corrcoef(path, steer)[0, 1]))
    turned = derivative(t, log["yaw_rate"], segment)[rows]
    solution, spread = jackknifed(np.stack([path, (speed * rate)[rows], turned, np.ones_like(path)], axis=1), steer)
    if correlation < MIN_CORRELATION or not 0.0 < spread[0] < LATERAL_TOLERANCE * abs(solution[0]):
        return None
    tolerance = math.hypot(TOLERANCE, float(spread[0] / solution[0]))
    powers = {"steer": 1, "yaw_rate": -1, "vx": 1}
    return Relation("the curvature driven", float(solution[0]), powers, correlation, tolerance)


def _relation(
    text: str, values: Array, expected: Array, powers: Mapping[str, int], tolerance: float = TOLERANCE
) -> Relation | None:
    """Ratio by the spreads of both; noise in one lowers the correlation and widens it. None where it hides all."""
    usable = np.abs(expected) <= np.quantile(np.abs(expected), 0.98) if expected.size else np.zeros(0, bool)
    if usable.sum() < 2 or np.var(values[usable]) == 0.0 or np.var(expected[usable]) == 0.0:
        return None
    correlation = float(np.corrcoef(values[usable], expected[usable])[0, 1])
    if not abs(correlation) >= MIN_CORRELATION:
        return None
    ratio = float(np.std(values[usable]) / np.std(expected[usable]))
    wide = math.hypot(tolerance, math.log(abs(correlation)))
    return Relation(text, math.copysign(ratio, correlation), powers, abs(correlation), wide)


def _words(channel: str, unit: str, sign: int) -> str:
    opposite = "has the opposite sign" if sign < 0 else ""
    other = f"is in {unit}, not {SI[channel]}" if unit != SI[channel] else ""
    return " and ".join(filter(None, (other, opposite)))


def _converted(log: DriveLog, channel: str, choice: Choice, by: list[Relation]) -> LogFinding:
    what = _words(channel, choice.unit, choice.sign)
    seen = "; ".join(f"{r.ratio:.3g} times {r.text}" for r in by)
    return _conversion(channel, f"{channel} {what}: {seen}", what, choice.factor, min(r.correlation for r in by))


def _conversion(channel: str, text: str, what: str, factor: float, confidence: float) -> LogFinding:
    def repair(log: DriveLog) -> DriveLog:
        return log.with_columns({channel: log[channel] / factor}, f"{channel} divided by {factor:.5g}: it {what}")

    return LogFinding(f"unit_{channel}", channel, text, factor, 0.0, "1", confidence, Action.CONVERTED, repair)


def _unexplained(relations: list[Relation], factors: Mapping[str, float]) -> list[LogFinding]:
    """Relations that no conversion makes right: of the steering a ratio nobody declared, of others an unknown unit."""
    findings: list[LogFinding] = []
    for relation in relations:
        left = relation.left(factors)
        most = STEER_UNEXPLAINED if "steer" in relation.powers else UNEXPLAINED
        if abs(left) <= max(most, SIGMAS * relation.tolerance):
            continue
        channel = "steer" if "steer" in relation.powers else max(relation.powers, key=lambda n: n != "vx")
        off = math.exp(left * relation.powers[channel]) * factors[channel] if math.isfinite(left) else -1.0
        remedy = "a steering wheel's angle? give its unit and ratio" if channel == "steer" else "give its unit or sign"
        text = f"{channel} is {off:.4g} times what the other channels say by {relation.text}: {remedy} with --columns"
        if channel not in {finding.channel for finding in findings}:
            sure = relation.correlation
            findings.append(
                LogFinding(f"unknown_unit_{channel}", channel, text, relation.ratio, 0.0, "1", sure, Action.REFUSED)
            )
    return findings


def _of_vy(log: DriveLog, vehicle: Vehicle, speed: str) -> list[LogFinding]:
    """Unit and sign of vy, most likely those of vx (`speed`): by the lateral acceleration that d/dt vy takes part in.

    Where that is not measured, by the rear axle: it slips against the turn in proportion to the cornering.
    """
    moving = log["vx"] > moving_speed(log)
    relation = None if "ay" in log.derived or not moving.any() else _swaying(log, moving)
    if relation is None:
        return _by_the_rear_axle(log, vehicle, moving)
    choices = [
        Choice(unit, sign, sign * f, PRICE * (unit != speed) + PRICE * (sign < 0))
        for unit, f in SPEEDS.items()
        for sign in (1, -1)
    ]
    choice = most_probable([relation], {"vy": choices})["vy"]
    if choice.factor == 1.0:
        return []
    what = _words("vy", choice.unit, choice.sign)
    text = f"vy {what}: ay less vx yaw_rate is {relation.ratio:.3g} times d/dt vy"
    return [_conversion("vy", text, what, choice.factor, relation.correlation)]


def _swaying(log: DriveLog, moving: NDArray[np.bool_]) -> Relation | None:
    """What d/dt vy is of ay less vx yaw_rate, in what varies within seconds: a bank and zeros of sensors do not.

    Of either only what the yaw acceleration does not: that is where vy is measured.
    """
    t, segment = log["t"], log.segment
    vx, rate, ay = (smoothed(t, log[n], segment) for n in ("vx", "yaw_rate", "ay"))
    window = np.hanning(round(SWAY_S / log.step) + 2)[1:-1]
    each = ay - vx * rate, derivative(t, log["vy"], segment), derivative(t, log["yaw_rate"], segment)
    swaying, expected, turning = ((s - np.convolve(s, window / window.sum(), "same"))[moving] for s in each)
    swaying, expected = (s - (s @ turning) / (turning @ turning) * turning for s in (swaying, expected))
    return _relation("d/dt vy", swaying, expected, {"vy": -1}, LATERAL_TOLERANCE)


def _by_the_rear_axle(log: DriveLog, vehicle: Vehicle, moving: NDArray[np.bool_]) -> list[LogFinding]:
    t, segment = log["t"], log.segment
    vx, vy, rate = (smoothed(t, log[n], segment)[moving] for n in ("vx", "vy", "yaw_rate"))
    cornering = vx * rate / GRAVITY
    if not float(cornering @ cornering) > 0.0 or float(np.std(vy)) == 0.0:
        return []
    left = {
        (unit, sign): _left_of((vehicle.lr * rate - vy / (sign * factor)) / vx, cornering)
        for unit, factor in SPEEDS.items()
        for sign in (1, -1)
    }
    as_written = _elsewhere((vehicle.lr * rate - vy) / vx, rate / vx, cornering, vehicle.wheelbase)
    unit, sign = min(left, key=lambda key: left[key][0])
    _, share = left[unit, sign]
    if (unit, sign) == ("m/s", 1) or share > TELLS or share > BETTER * as_written:
        return []
    what = _words("vy", unit, sign)
    text = f"vy {what}: the rear axle then slips as it corners, to {100 * share:.0f} % of its slip"
    return [_conversion("vy", text, what, sign * SPEEDS[unit], 1.0 - share)]


def _left_of(slip: Array, cornering: Array) -> tuple[float, float]:
    """What cornering leaves of the rear slip with any tyre's stiffness: standard deviation, and as a share."""
    stiffness = np.clip(float(slip @ cornering) / float(cornering @ cornering), 1 / STIFFNESS[1], 1 / STIFFNESS[0])
    rest = float(np.std(slip - stiffness * cornering))
    return rest, rest / max(float(np.std(slip)), 1e-12)


def _elsewhere(slip: Array, path: Array, cornering: Array, wheelbase: float) -> float:
    """That share with a sensor of vy that may be anywhere on the car: `slip` at the CoG is then off by x `path`."""
    (x, _), *_ = np.linalg.lstsq(np.stack([-path, cornering], axis=1), slip, rcond=None)
    return _left_of(slip + np.clip(x, -wheelbase, wheelbase) * path, cornering)[1]


def _of_positions(log: DriveLog) -> list[LogFinding]:
    """Positions that turn against the yaw rate: a mirrored map, or axes to the right; the motion alone cannot tell."""
    moving = log["vx"] > moving_speed(log)
    if not {"x", "y"} <= log.columns.keys() or not moving.any():
        return []
    t, segment = log["t"], log.segment
    east, north = (smoothed(t, derivative(t, log[n], segment), segment) for n in ("x", "y"))
    turning = derivative(t, np.unwrap(np.arctan2(north, east)), segment)
    relation = _relation("yaw_rate", turning[moving], smoothed(t, log["yaw_rate"], segment)[moving], {"yaw_rate": -1})
    if relation is None or relation.ratio > 0.0:
        return []
    text = (
        "x, y turn left where yaw_rate turns right: give with --columns the sign of y, or of vy, yaw_rate, ay and steer"
    )
    return [LogFinding("mirrored_y", "y", text, relation.ratio, 0.0, "1", relation.correlation)]


def _of_heading(log: DriveLog) -> list[LogFinding]:
    """A yaw that counts from another axis than x: a compass begins in the north. Quarters of a turn, by positions."""
    moving = log["vx"] > moving_speed(log)
    if not {"x", "y", "yaw"} <= log.columns.keys() or not moving.any():
        return []
    east, north = (derivative(log["t"], log[name], log.segment) for name in ("x", "y"))
    off = np.mean(np.exp(1j * (np.arctan2(north, east) - np.arctan2(log["vy"], log["vx"]) - log["yaw"]))[moving])
    quarters = round(float(np.angle(off)) / (0.5 * math.pi))
    if quarters == 0 or abs(off) < MIN_CORRELATION:
        return []
    what = f"counts from {90 * quarters:+d} deg of x"

    def repair(log: DriveLog) -> DriveLog:
        return log.with_columns({"yaw": log["yaw"] + 0.5 * math.pi * quarters}, f"yaw {what}: turned by as much")

    text, sure = f"yaw {what}, by the direction in which x, y move", float(abs(off))
    return [LogFinding("axis_yaw", "yaw", text, 0.5 * math.pi * quarters, 0.0, "rad", sure, Action.CONVERTED, repair)]


def _of_wheels(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Units of the wheel speeds against vx."""
    moving, findings = log["vx"] > moving_speed(log), []
    per_speed = 1.0 / vehicle.wheel_radius
    units = {**SPEEDS, "rad/s of the wheel": per_speed, "rpm of the wheel": per_speed * 30.0 / math.pi}
    for name in (n for n in WHEELS if n in log):
        relation = _relation("vx", log[name][moving], log["vx"][moving], {name: 1})
        if relation is None or relation.ratio < 0.0:
            continue
        unit = min(units, key=lambda u: abs(math.log(relation.ratio / units[u])))
        if unit != "m/s" and abs(math.log(relation.ratio / units[unit])) < TOLERANCE:
            what = f"is in {unit}, not m/s"
            text = f"{name} {what}: {relation.ratio:.3g} times vx"
            findings.append(_conversion(name, text, what, units[unit], relation.correlation))
    return findings


def _percent(log: DriveLog) -> list[LogFinding]:
    if "throttle" not in log or not 1.5 < float(log["throttle"].max()) <= 101.0:
        return []
    text = f"throttle is in percent, not 0..1: its maximum is {log['throttle'].max():.3g}"
    return [_conversion("throttle", text, "is in percent", 100.0, 1.0)]


def _beyond(log: DriveLog) -> list[LogFinding]:
    """Channels that do what no car does, also after every conversion."""
    moving: NDArray[np.bool_] = log["vx"] > moving_speed(log)
    findings = []
    for channel, limit in LIMITS.items():
        if channel in log.derived or not moving.any():
            continue
        reached = float(np.quantile(np.abs(log[channel][moving]), ALMOST_ALL))
        if reached > limit:
            text = (
                f"{channel} reaches {reached:.4g}, no car does more than {limit:.4g} (SI): is it in another unit?"
                " give it with --columns"
            )
            findings.append(LogFinding(f"beyond_{channel}", channel, text, reached, 0.0, "SI", 1.0, Action.REFUSED))
    return findings
