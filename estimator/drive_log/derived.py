"""Channels a log may lack, from those it has: drive from wheel speeds or pedals, ax and ay from velocities."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_gateway.car.car import load_car
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError

DERIVATIVE_SPAN_S = 0.3
"""Span of the local parabola that differentiates velocities: passes what a car does, up to about 3 Hz."""

BY_VELOCITIES = {
    "ax": "d/dt vx - vy yaw_rate, so grade counts as acceleration",
    "ay": "d/dt vy + vx yaw_rate, so bank counts as acceleration",
}
"""How an acceleration is described that was derived."""

FULL_THROTTLE_DRIVE = 0.10
"""Slip ratio taken to stand for full throttle."""

FULL_BRAKE_DRIVE = 0.30
"""Slip ratio taken to stand for full braking, pressure or pedal: brakes act on four wheels, the engine on two."""

OF_PEDALS = "so C_x includes the scale of the pedals"
"""How a drive is described that was derived from throttle and brake."""

BY_STATE_FILTER = {"vy": "by the state filter: its error follows the motion for seconds, as a sensor's noise does not"}
"""What a log of the running loop has of its own estimator, and no sensor measures."""

PEDALS_MUST_EXPLAIN = (0.3, 1.5)
"""Pedals replace wheel speeds where their correlation with d/dt vx is above the first, and so many times as high."""


def add_missing_channels(
    path: Path, columns: dict[str, Array], segment: NDArray[np.int64]
) -> tuple[dict[str, Array], dict[str, str]]:
    """`columns` with `ax`, `ay`, `drive` filled in where missing, and column -> how it was derived.

    Raises:
        InputError: `drive` is missing and nothing it could be derived from is there.
    """
    complete, derived = dict(columns), {}
    for axis, how in BY_VELOCITIES.items():
        if axis not in columns:
            complete[axis], derived[axis] = specific_force(axis, columns, segment), how
    if "drive" not in columns:
        complete["drive"], derived["drive"] = derive_drive(path, columns, segment)
    return complete, derived


def specific_force(axis: str, columns: Mapping[str, Array], segment: NDArray[np.int64]) -> Array:
    """(n,) `ax` or `ay` on a level road from velocities, m/s2."""
    t, vx, vy, rate = (columns[name] for name in ("t", "vx", "vy", "yaw_rate"))
    return derivative(t, vx, segment) - vy * rate if axis == "ax" else derivative(t, vy, segment) + vx * rate


def derivative(t: Array, values: Array, segment: NDArray[np.int64], span: float = DERIVATIVE_SPAN_S) -> Array:
    """d/dt of (n,) `values` by local parabolas (Savitzky & Golay 1964) within each uninterrupted segment."""
    step, half = _parabola(t, span)
    result = np.zeros_like(values)
    for rows in _segments(segment):
        if rows.stop - rows.start > 2 * half:
            result[rows] = _slopes(values[rows], half) / step
        elif rows.stop - rows.start > 1:
            result[rows] = np.gradient(values[rows], t[rows])
    return result


def smoothed(t: Array, values: Array, segment: NDArray[np.int64], span: float = DERIVATIVE_SPAN_S) -> Array:
    """(n,) `values` by the same parabolas."""
    _, half = _parabola(t, span)
    result = values.copy()
    for rows in _segments(segment):
        if rows.stop - rows.start > 2 * half:
            result[rows] = _heights(values[rows], half)
    return result


def _parabola(t: Array, span: float) -> tuple[float, int]:
    """Time between samples, s, and samples on either side of a parabola of `span` s."""
    step = float(np.median(np.diff(t)))
    return step, max(2, round(0.5 * span / step))


def _segments(segment: NDArray[np.int64]) -> Iterator[slice]:
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(segment)) + 1, [len(segment)]])
    return (slice(int(a), int(b)) for a, b in itertools.pairwise(bounds))


def _slopes(values: Array, half: int) -> Array:
    """Slope per sample of the parabola through each sample and `half` on either side; at the ends of the last one."""
    at = np.arange(-half, half + 1)
    first, last = (np.polyder(parabola) for parabola in _at_the_ends(values, half))
    inner = np.convolve(values, -at / (at @ at), "valid")
    return np.concatenate([np.polyval(first, at[:half]), inner, np.polyval(last, at[-half:])])


def _heights(values: Array, half: int) -> Array:
    """Height of the same parabola."""
    at = np.arange(-half, half + 1)
    first, last = _at_the_ends(values, half)
    weights = np.linalg.pinv(np.stack([np.ones_like(at), at, at**2], axis=1).astype(float))[0]
    inner = np.convolve(values, weights, "valid")
    return np.concatenate([np.polyval(first, at[:half]), inner, np.polyval(last, at[-half:])])


def _at_the_ends(values: Array, half: int) -> tuple[Array, Array]:
    """Coefficients (3,) of the first and the last parabola."""
    at, size = np.arange(-half, half + 1), 2 * half + 1
    return np.polyfit(at, values[:size], 2), np.polyfit(at, values[-size:], 2)


def derive_drive(path: Path, columns: dict[str, Array], segment: NDArray[np.int64]) -> tuple[Array, str]:
    """Slip-ratio command from wheel speeds, else from throttle and brake; where both are there, what explains more."""
    slip = _slip_from_wheels(columns)
    pedals = _drive_from_pedals(columns)
    if slip is None and pedals is None:
        raise InputError(
            f"{path}: row 1: column drive is missing and cannot be derived:"
            " wheel_speed_rl and wheel_speed_rr, or throttle, are needed"
        )
    if slip is None or pedals is None:
        return slip or pedals  # type: ignore[return-value]  # one of them is there
    vx_dot = derivative(columns["t"], columns["vx"], segment)
    moving = columns["vx"] > 0.2 * float(np.quantile(columns["vx"], 0.95))
    by_slip, by_pedals = (abs(_correlation(d[0][moving], vx_dot[moving])) for d in (slip, pedals))
    least, times = PEDALS_MUST_EXPLAIN
    if by_pedals < max(least, times * by_slip):
        return slip
    return pedals[0], f"{pedals[1]}; wheel-speed slip follows d/dt vx less ({by_slip:.2f} against {by_pedals:.2f})"


def _slip_from_wheels(columns: dict[str, Array]) -> tuple[Array, str] | None:
    """(rear wheel speed - reference) / reference; the undriven front wheels are the reference where there are any.

    The wheels roll without slip at the median, so a wrong rolling radius does not count as slip.
    """
    if not {"wheel_speed_rl", "wheel_speed_rr"} <= columns.keys():
        return None
    rear = 0.5 * (columns["wheel_speed_rl"] + columns["wheel_speed_rr"])
    front = {"wheel_speed_fl", "wheel_speed_fr"} <= columns.keys()
    reference = 0.5 * (columns["wheel_speed_fl"] + columns["wheel_speed_fr"]) if front else columns["vx"]
    fast = float(np.quantile(np.abs(columns["vx"]), 0.95))
    moving = np.abs(reference) > 0.3 * fast
    scale = float(np.median(rear[moving] / reference[moving])) if moving.any() else 1.0
    how = "slip of the rear wheel speeds against " + ("the front wheel speeds" if front else "vx")
    how += f", both in the ratio {scale:.4f} when rolling"
    return (rear / scale - reference) / np.maximum(np.abs(reference), 0.1 * fast), how


def _drive_from_pedals(columns: dict[str, Array]) -> tuple[Array, str] | None:
    if "throttle" not in columns:
        return None
    brake = columns.get("brake", np.zeros_like(columns["throttle"]))
    in_pascal, share = is_pressure(brake), brake_share(brake)
    how = (
        f"{FULL_THROTTLE_DRIVE:g} throttle - {FULL_BRAKE_DRIVE:g} brake"
        + (f" / {_full_pressure() / 1e6:g} MPa" if in_pascal else "")
        + f", {OF_PEDALS}"
    )
    return FULL_THROTTLE_DRIVE * columns["throttle"] - FULL_BRAKE_DRIVE * share, how


def is_pressure(brake: Array) -> bool:
    """Whether a brake channel is in Pa and not a pedal, 0..1."""
    return bool(brake.max() > 1.5)


def brake_share(brake: Array) -> Array:
    """Brake channel, Pa or 0..1, as a share of full braking."""
    return brake / _full_pressure() if is_pressure(brake) else brake


def _full_pressure() -> float:
    """Of the car that is operated, Pa."""
    return load_car().powertrain.brake_pressure_max


def _correlation(a: Array, b: Array) -> float:
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0 else 0.0
