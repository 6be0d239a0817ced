"""Sources of a bag as one table: for each quantity the best source, mounting and delays found, all at the same times.

Mounting: an accelerometer's axes are those of the unit. Gravity tells which way is up, d/dt v and v yaw_rate tell which
of four quarter turns it has. Delays: the derivative of each speed follows the specific force along the car.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.bag.messages import STEERING_MOTOR, Quantities
from estimator.drive_log.bag.reading import BagDrive, BagSource, read_sources
from estimator.drive_log.derived import derivative
from estimator.drive_log.lag import lag_between
from estimator.drive_log.text_table import WrittenTable
from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config, OriginConfig
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import VY_STD
from hil_gateway.session.logs.bag import KINDS as CAN_KINDS
from hil_gateway.track.geodesy import LocalMap

TOGETHER: tuple[tuple[str, ...], ...] = (
    ("vx", "vy", VY_STD), ("yaw",), ("yaw_rate",), ("ax", "ay", "az"), ("x", "y"), ("z",), ("steer",), ("throttle",),
    ("brake", "brake_balance"), ("engine_speed", "gear"),
    ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr"),
)  # fmt: skip
"""quantities that are taken from one source: the first of each must be there"""
NEEDED = {
    "vx": "a velocity (INSPVA, Odometry, TwistStamped, vectornav, or BESTVEL with a heading)",
    "yaw_rate": "a yaw rate (Imu, RAWIMU, Odometry)",
    "steer": "a steering angle (raptor_dbw_msgs/SteeringReport, AckermannDriveStamped)",
}
RATES = (100.0, 50.0, 25.0)
"""samples/s of the table: the first that the slowest needed source nearly reaches"""
NEARLY = 0.75
CAR_SLIP = 0.5
"""rad: a velocity further off the x axis for a tenth of the drive is not in body axes"""
OTHER_GEAR = 0.1
"""Share by which an engine is off the speed of its gear at most: driven wheels slip and grow by less than half of it"""
STOP = 1.0
"""m/s, below which a direction of motion is none"""
GAP_STEPS, GAP_S = 4.0, 0.1
"""A source without a sample for longer leaves a gap: of its steps, and in any case"""
LONGEST_DELAY_S, LEAST_DELAY_STEPS, SURE = 0.5, 0.5, 0.5
"""of a source; what is less than half a step of it is none; correlation from which a delay or a mounting is believed"""


@dataclass(frozen=True)
class Chosen:
    """Quantities of one source on the way into the table."""

    source: BagSource
    names: tuple[str, ...]


def read_bag_drive(path: Path) -> WrittenTable:
    """The drive in a bag, in SI and ISO 8855 axes.

    Raises:
        InputError: no bag, or one that lacks what a drive log needs.
    """
    drive = read_sources(path)
    drive.sources = [_with_motion(_steered(source, drive), drive) for source in _mapped(drive)]
    chosen = _choose(drive)
    _check(drive, chosen)
    t = _times(drive, chosen)
    columns = _mounted(t, _columns(t, chosen), drive)
    columns = _without_delays(t, columns, chosen, drive)
    whole = np.all([np.isfinite(columns[n]) for c in chosen if c.names[0] in NEEDED for n in c.names], axis=0)
    if not whole.all():
        drive.notes.append(f"{int((~whole).sum())} of {len(t)} rows are left out: a source that is needed was silent")
    there = {name: column[whole] for name, column in columns.items() if np.isfinite(column).any()}
    columns = _with_drive(there, drive)
    names = list(columns)
    values = np.column_stack([t[whole], *columns.values()])
    lines = np.arange(1, len(values) + 1, dtype=np.int64)
    return WrittenTable(("t", *names), ("",) * (len(names) + 1), values, lines, 0, tuple(drive.notes))


def _mapped(drive: BagDrive) -> list[BagSource]:
    """Sources with x, y instead of latitude and longitude, all on one map."""
    first = next((s for s in sorted(drive.sources, key=lambda s: s.message.rank) if "latitude" in s.quantities), None)
    if first is None:
        return drive.sources
    at = int(np.argmax(np.isfinite(first.quantities["latitude"])))
    origin = OriginConfig(
        latitude=float(first.quantities["latitude"][at]), longitude=float(first.quantities["longitude"][at])
    )
    drive.notes.append(f"x, y are east and north of {origin.latitude:.6f}, {origin.longitude:.6f} deg")
    local = LocalMap(origin)
    return [_on_map(source, local) if "latitude" in source.quantities else source for source in drive.sources]


def _on_map(source: BagSource, local: LocalMap) -> BagSource:
    rest = {n: v for n, v in source.quantities.items() if n not in ("latitude", "longitude")}
    places = zip(source.quantities["latitude"], source.quantities["longitude"], strict=True)
    x, y = np.array([local.to_map(*p) if np.isfinite(p).all() else (np.nan, np.nan) for p in places]).T
    return replace(source, quantities={**rest, "x": x, "y": y})


def _steered(source: BagSource, drive: BagDrive) -> BagSource:
    """The angle at the steering motor as that of the road wheels."""
    ratio = drive.config.vehicle.steering_ratio
    named = {name: ("steer", 1.0 / ratio) if name == STEERING_MOTOR else (name, 1.0) for name in source.quantities}
    return replace(source, quantities={n: k * source.quantities[old] for old, (n, k) in named.items()})


def _with_drive(columns: dict[str, Array], drive: BagDrive) -> dict[str, Array]:
    """With `drive` as the gateway makes it of the same reports, by the declared power train of the car."""
    pedals = ("throttle", "brake", "engine_speed", "gear")
    if not all(name in columns and np.isfinite(columns[name]).all() for name in pedals):
        return columns
    car = drive.config.car.name
    if not _in_gear(columns, drive.config):
        drive.notes.append(f"engine speed and gear are not those of the power train of the car {car}: it is not used")
        return columns
    actuation = Actuation(drive.config.vehicle, drive.config.powertrain)
    rows = zip(*(columns[name].tolist() for name in pedals), strict=True)
    made = [actuation.to_drive(ActuatorPositions(0.0, a, p, p, int(gear)), w, int(gear)) for a, p, w, gear in rows]
    drive.notes.append(f"drive is made of {', '.join(pedals)} by the declared power train of the car {car}")
    return columns | {"drive": np.array(made)}


def _in_gear(columns: Mapping[str, Array], config: Config) -> bool:
    """Whether the engine turns as fast as the declared gears make it at the speed of the car."""
    ratio = np.array([config.powertrain.ratio(int(gear)) for gear in columns["gear"]])
    fast = columns["vx"] > 0.5 * columns["vx"].max(initial=0.0)
    if not fast.any():
        return False
    turning, engine = ratio * columns["vx"] / config.vehicle.wheel_radius, columns["engine_speed"]
    return bool(np.median(np.abs(turning - engine)[fast]) < OTHER_GEAR * np.median(engine[fast]))


def _with_motion(source: BagSource, drive: BagDrive) -> BagSource:
    """Velocity in body axes where the source has a heading; one over ground is turned, and that is said."""
    found = dict(source.quantities)
    if "vx" in found and _over_ground(found["vx"], found["vy"]):
        drive.notes.append(f"{source.topic}: its velocity is along east and north, not the car's axes: turned")
        found["east"], found["north"] = found.pop("vx"), found.pop("vy")
    if "north" in found and (yaw := _heading(source, found, drive)) is not None:
        east, north = found.pop("east"), found.pop("north")
        found["vx"] = east * np.cos(yaw) + north * np.sin(yaw)
        found["vy"] = north * np.cos(yaw) - east * np.sin(yaw)
    return replace(source, quantities=found)


def _over_ground(vx: Array, vy: Array) -> bool:
    moving = np.hypot(vx, vy) > STOP
    return bool(moving.any()) and float(np.mean(np.abs(vy[moving]) > CAR_SLIP * np.abs(vx[moving]))) > 0.1


def _heading(source: BagSource, found: Quantities, drive: BagDrive) -> Array | None:
    """Yaw at the times of a source: its own, else the best of another source."""
    if "yaw" in found:
        return np.asarray(found["yaw"])
    others = sorted((s for s in drive.sources if "yaw" in s.quantities), key=lambda s: s.message.rank)
    return _at("yaw", source.t, others[0].t, others[0].quantities["yaw"]) if others else None


def _choose(drive: BagDrive) -> list[Chosen]:
    """For each group of quantities the source of the best rank, of equals the quickest; what is used is said."""
    chosen = []
    for names in TOGETHER:
        able = [s for s in drive.sources if names[0] in s.quantities and np.isfinite(s.quantities[names[0]]).any()]
        if not able:
            continue
        best = min(able, key=lambda s: (s.message.rank, -s.rate, s.topic))
        there = tuple(name for name in names if name in best.quantities)
        chosen.append(Chosen(best, there))
        said = f" ({best.message.said})" if best.message.said else ""
        drive.notes.append(f"{', '.join(there)} from {best.topic}, {best.rate:.0f} Hz{said}")
    return chosen


def _check(drive: BagDrive, chosen: Sequence[Chosen]) -> None:
    there = {name for one in chosen for name in one.names}
    for name, what in NEEDED.items():
        if name not in there:
            if any(kind in CAN_KINDS for kind in drive.other):
                remedy = "`hil session import --estimate` makes a session of its CAN frames"
                raise InputError(f"{drive.path}: the bag has no {what.removeprefix('a ')}; {remedy}")
            topics = [s.topic for s in drive.sources] + [f"of {kind}" for kind in sorted(drive.other)]
            raise InputError(
                f"{drive.path}: the bag has no {what.removeprefix('a ')}; it has {', '.join(topics)[:300]}"
            )
    if "vy" not in there:
        raise InputError(f"{drive.path}: the bag has no heading beside its velocity: vy is not known without one")


def _times(drive: BagDrive, chosen: Sequence[Chosen]) -> Array:
    """Times of the table: as long as all that is needed was there, as quick as the slowest of it."""
    needed = [one.source for one in chosen if one.names[0] in NEEDED]
    slowest = min(source.rate for source in needed)
    rate = next((r for r in RATES if slowest > NEARLY * r), RATES[-1])
    start, end = max(source.t[0] for source in needed), min(source.t[-1] for source in needed)
    if end - start < 2.0 / rate:
        raise InputError(f"{drive.path}: velocity, yaw rate and steering were never recorded at the same time")
    drive.notes.append(f"all are put at {rate:.0f} samples/s; the slowest of what is needed has {slowest:.0f}")
    return np.asarray(start + np.arange(int((end - start) * rate) + 1) / rate)


def _columns(t: Array, chosen: Sequence[Chosen], delays: Mapping[str, float] | None = None) -> dict[str, Array]:
    """Quantities at the times of the table, each as much earlier as its topic is late."""
    moved = {one.source.topic: t + (delays or {}).get(one.source.topic, 0.0) for one in chosen}
    return {
        name: _at(name, moved[one.source.topic], one.source.t, one.source.quantities[name])
        for one in chosen
        for name in one.names
    }


def _at(name: str, t: Array, source_t: Array, values: Array) -> Array:
    """A quantity at times t, NaN in gaps: averaged over a step where it comes more often, else put in between."""
    known = np.isfinite(values)
    at, values = source_t[known], values[known]
    if len(at) < 2:
        return np.full(len(t), np.nan)
    step, own = (float(np.median(np.diff(x))) for x in (t, at))
    i = np.clip(np.searchsorted(at, t, side="right"), 1, len(at) - 1)
    if name == "gear":
        out = values[i - 1]
    elif own < NEARLY * step:
        out = _averaged(t, step, at, values)
    else:
        out = np.interp(t, at, np.unwrap(values) if name == "yaw" else values)
    apart = at[i] - at[i - 1]
    outside = (t < at[0] - own) | (t > at[-1] + own)
    return np.where((apart > max(GAP_STEPS * own, GAP_S)) | outside, np.nan, out)


def _averaged(t: Array, step: float, at: Array, values: Array) -> Array:
    """Means over one step around each t, as far as there are samples."""
    total = np.concatenate([[0.0], np.cumsum(np.diff(at) * (values[1:] + values[:-1]) / 2)])
    start, end = (np.clip(t + half, at[0], at[-1]) for half in (-step / 2, step / 2))
    mean = (np.interp(end, at, total) - np.interp(start, at, total)) / np.maximum(end - start, 1e-9)
    return np.where(end > start, mean, np.interp(t, at, values))


def _mounted(t: Array, columns: dict[str, Array], drive: BagDrive) -> dict[str, Array]:
    """The accelerometer in the car's axes."""
    if "ax" not in columns or "ay" not in columns:
        return columns
    up = columns.get("az", np.zeros(0))
    down = np.isfinite(up).any() and float(np.nanmedian(up)) < -0.5 * GRAVITY
    if down:
        columns = columns | {name: -columns[name] for name in ("ay", "az", "yaw_rate")}
        drive.notes.append("the accelerometer hangs upside down: ay, az and yaw_rate have the other sign")
    turn, correlation = _quarter_turn(t, columns)
    if correlation < SURE:
        drive.notes.append(f"how the accelerometer is mounted cannot be told (correlation {correlation:.2f}): as it is")
        return columns
    if turn:
        drive.notes.append(f"the accelerometer is mounted turned by {90 * turn} deg: ax, ay are turned back")
    ax, ay = _turned(columns["ax"], columns["ay"], turn)
    return columns | {"ax": ax, "ay": ay}


def _turned(ax: Array, ay: Array, turn: int) -> tuple[Array, Array]:
    """Axes of the car, for a unit whose x axis points `turn` quarters to the left of the car's."""
    both = (ax + 1j * ay) * 1j**turn
    return both.real, both.imag


def _quarter_turn(t: Array, columns: Mapping[str, Array]) -> tuple[int, float]:
    """Quarter turns of the accelerometer against the car, and the correlation that says so."""
    names = ("vx", "yaw_rate", "ax", "ay")
    whole = np.all([np.isfinite(columns[n]) for n in names], axis=0)
    if not whole.any():
        return 0, 0.0
    vx, rate, ax, ay = (np.where(whole, columns[n], 0.0) for n in names)
    motion = (_slope(t, vx) + 1j * vx * rate)[whole]
    felt = (ax + 1j * ay)[whole]
    motion, felt = motion - motion.mean(), felt - felt.mean()
    size = float(np.sqrt(np.vdot(motion, motion).real * np.vdot(felt, felt).real))
    if size == 0.0:
        return 0, 0.0
    products = [float(np.vdot(felt * 1j**turn, motion).real) / size for turn in range(4)]
    return int(np.argmax(products)), max(products)


def _slope(t: Array, values: Array) -> Array:
    return derivative(t, values, np.zeros(len(t), np.int64))


def _without_delays(t: Array, columns: dict[str, Array], chosen: Sequence[Chosen], drive: BagDrive) -> dict[str, Array]:
    """Sources of speeds put where the accelerometer is."""
    delays = dict(_delays(t, columns, chosen))
    for topic, delay in delays.items():
        drive.notes.append(
            f"{topic} is {1e3 * delay:.0f} ms {'late' if delay > 0 else 'early'} against ax: moved by that"
        )
    if not delays:
        return columns
    moved = _columns(t, [one for one in chosen if one.source.topic in delays], delays)
    return columns | moved


UNDRIVEN = "wheel_speed_f"
"""wheels whose speeds tell a delay: the slip of driven ones grows with ax, and lets them lead by v m / C_x, to 0.2 s"""


def _delays(t: Array, columns: Mapping[str, Array], chosen: Sequence[Chosen]) -> Iterator[tuple[str, float]]:
    if "ax" not in columns:
        return
    of_ax = next(one.source.topic for one in chosen if "ax" in one.names)
    for one in chosen:
        speeds = [n for n in one.names if n == "vx" or n.startswith(UNDRIVEN)]
        if not speeds or one.source.topic == of_ax:
            continue
        lag = _lag(t, columns["ax"], np.mean([columns[n] for n in speeds], axis=0))
        if lag is not None and abs(lag) > LEAST_DELAY_STEPS / one.source.rate:
            yield one.source.topic, lag


def _lag(t: Array, ax: Array, speed: Array) -> float | None:
    """s by which d/dt speed follows ax, where that is sure."""
    usable: NDArray[np.bool_] = np.isfinite(ax) & np.isfinite(speed)
    if not usable.any():
        return None
    slope = _slope(t, np.where(usable, speed, np.interp(t, t[usable], speed[usable])))
    step = float(np.median(np.diff(t)))
    lag = lag_between(np.where(usable, ax, 0.0), slope, usable, step, LONGEST_DELAY_S)
    if lag is None or lag.correlation < SURE or abs(lag.value) < 3.0 * lag.std:
        return None
    return lag.value
