"""Signals that depend on the past: pure delay, first-order lag and play on recorded, possibly irregular, samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

import casadi as ca
import numpy as np

from estimator.model.effect import Prepare
from estimator.model.library import Library, load_library
from estimator.model.single_track import BEFORE_STEP_S, DRIVE_BEFORE, Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr

CHANGES = ("shift", "behind", "lost", "swing")
"""What effects with memory take an input for instead of what is reported: auxiliary signals `{name}_{change}`."""
SLOWEST = 1.0
"""Below this speed, m/s, slip angles and their lag do not grow further."""


def followed(signals: Mapping[str, Array], name: str) -> Array:
    """The input `name` as the effects that were prepared before leave it, shape (n,)."""
    return np.asarray(signals[name] + sum(signals.get(f"{name}_{change}", 0.0) for change in CHANGES))


def axle_courses(signals: Mapping[str, Array], vehicle: Vehicle) -> dict[str, Array]:
    """Angles (n,), rad, at which the axles move against the car: what slip angles have without the steering."""
    vy, rate, speed = signals["vy"], signals["yaw_rate"], np.maximum(signals["vx"], SLOWEST)
    lateral = {"course_f": vy + vehicle.lf * rate, "course_r": vy - vehicle.lr * rate}
    return {name: np.arctan(v / speed) for name, v in lateral.items()}


def input_delay(name: str) -> tuple[Callable[[Terms, Expr], None], Prepare]:
    """Hook and preparation of a pure delay, s, of the input `name` ("steer", "drive").

    On recorded data the reported signal is shifted, by the auxiliary signal `{name}_shift`; while driving it runs
    straight between its values of `DRIVE_BEFORE`; without a past, u(t - T) is replaced by u - T du/dt, right to first
    order in T.
    """

    before = DRIVE_BEFORE if name == "drive" else ()
    return partial(_late_hook, name, "shift", before), partial(_shifted, name)


def input_lag(name: str) -> tuple[Callable[[Terms, Expr], None], Prepare]:
    """The same of a first-order lag with a time constant, s, by the auxiliary signal `{name}_behind`."""
    return partial(_late_hook, name, "behind", ()), partial(_behind, name)


def _late_hook(name: str, change: str, before: tuple[str, ...], terms: Terms, seconds: Expr) -> None:
    without_prepared = _before(terms, before, seconds) - seconds * terms.auxiliary(f"{name}_rate")
    setattr(terms, name, getattr(terms, name) + terms.aux.get(f"{name}_{change}", without_prepared))


def _before(terms: Terms, names: tuple[str, ...], seconds: Expr) -> Expr:
    """What an input was `seconds` ago, less what it is, from its values at steps of `BEFORE_STEP_S`."""
    steps, total, value = seconds / BEFORE_STEP_S, 0.0, 0.0
    for k, name in enumerate(names):
        # no delay is negative: without a lower bound of the first part the slope at none is that of the past
        part = ca.fmin(steps - k if k == 0 else ca.fmax(steps - k, 0.0), 1.0)
        total = total + part * (terms.auxiliary(name) - value)
        value = terms.auxiliary(name)
    return total


def _behind(
    name: str, signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]
) -> dict[str, Array]:
    asked = signals[name]
    followed = relaxed(signals["t"], asked, np.full(len(asked), parameters[0]))
    return {f"{name}_behind": followed - asked}


def _shifted(
    name: str, signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]
) -> dict[str, Array]:
    return {f"{name}_shift": delayed(signals["t"], signals[name], parameters[0]) - signals[name]}


def delayed(t: Array, signal: Array, delay: float) -> Array:
    """signal(t - delay), shape (n,), linear between samples, held before the first and after the last."""
    return np.interp(t - delay, t, signal)


def relaxed(t: Array, signal: Array, time_constant: Array) -> Array:
    """First-order lag of one or more signals (..., n), with a time constant, s, that may change from sample to sample.

    The input is taken as linear between samples (exact for a ramp), so the result does not depend on the rate.
    """
    library = _library()
    if library is not None:
        out = np.empty(signal.shape)
        arrays = (np.ascontiguousarray(a) for a in (t, time_constant, signal))
        library.call("relaxed", signal.size // signal.shape[-1], signal.shape[-1], *arrays, out)
        return out
    ratio = np.diff(t) / np.maximum(time_constant[1:], 1e-9)
    decay = np.exp(-ratio)
    slope_gain = np.where(ratio > 1e-6, 1.0 - (1.0 - decay) / np.maximum(ratio, 1e-12), 0.5 * ratio)
    return _scan(signal, decay, slope_gain)


def swung(t: Array, signal: Array, period: float, damping: float) -> Array:
    """What follows a signal (n,) as a mass on a spring does: natural period, s, and damping ratio below 1.

    Its two modes are conjugate, each a first-order lag with a complex pole; linear between samples, at rest before.
    """
    if period <= 0.0:
        return signal.copy()
    root = np.sqrt(1.0 - damping**2)
    mode = _mode(t, signal, 2.0 * np.pi / period * (-damping + 1j * root))
    return np.asarray(np.real((1.0 - 1j * damping / root) * mode))


def _mode(t: Array, signal: Array, pole: complex) -> Array:
    """First-order lag (n,), complex, of a signal (n,) with a complex `pole`, 1/s."""
    library = _library()
    if library is not None:
        out = np.empty(signal.shape, complex)
        library.call("mode", len(t), np.ascontiguousarray(t), np.array([pole]), np.ascontiguousarray(signal), out)
        return out
    ratio = -pole * np.diff(t)
    decay = np.exp(-ratio)
    return _scan(signal.astype(complex), decay, 1.0 - (1.0 - decay) / ratio)


def after_play(signal: Array, gap: float) -> Array:
    """What follows a signal (n,) across a `gap`, in its unit: y[i] = y[i-1], moved to within half a gap of signal[i].

    It starts in the middle of the gap. A sequence of limits is one pair of limits, so that a scan doubles its reach.
    """
    low, high = signal - 0.5 * gap, signal + 0.5 * gap
    low[:1] = high[:1] = signal[:1]
    reach = 1
    while reach < len(signal):
        earlier = low[:-reach].copy(), high[:-reach].copy()
        own = low[reach:].copy(), high[reach:].copy()
        low[reach:], high[reach:] = (np.minimum(np.maximum(limit, own[0]), own[1]) for limit in earlier)
        if np.array_equal(low, high):
            break
        reach *= 2
    return low


def held(t: Array, signal: Array, time_constant: float) -> Array:
    """What holds the largest of a signal (n,) >= 0 and lets go by a time constant, s: max(u, y_before exp(-dt / T)).

    As a logarithm it is a running maximum of what falls along a line.
    """
    fallen = (t - t[0]) / max(time_constant, 1e-9)
    log = np.log(np.maximum(signal, np.finfo(float).tiny))
    return np.asarray(np.exp(np.maximum.accumulate(log + fallen) - fallen))


@cache
def _library() -> Library | None:
    return load_library(Path(__file__).with_name("recursion.c"))


def _scan(signal: Array, decay: Array, slope_gain: Array) -> Array:
    """The recursion of `recursion.c` without a compiler: a linear scan that doubles its reach every pass."""
    drive = (1.0 - decay) * signal[..., :-1] + slope_gain * np.diff(signal)
    gain = np.concatenate(([1.0], decay))
    value = np.concatenate((signal[..., :1], drive), axis=-1)
    reach = 1
    while reach < len(gain) and np.max(np.abs(gain[reach:])) > 1e-14:
        value[..., reach:] += gain[reach:] * value[..., :-reach]
        gain[reach:] *= gain[:-reach]
        reach *= 2
    return value
