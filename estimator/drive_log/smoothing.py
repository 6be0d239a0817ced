"""Zero-phase smoothing of measured states: what noise in the slip angles would bias, an estimate of the state does not.

A tyre force fitted against noisy slip angles comes out too flat (errors in variables). The Wiener smoother takes
the noise out as far as the spectrum allows; velocities are smoothed as the difference to the integrated
accelerometer, which leaves only slow errors to be smoothed.
Source: Wiener, Extrapolation, Interpolation and Smoothing of Stationary Time Series (1949).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from hil_gateway.process.arrays import Array

PAD = 1000
"""Samples reflected at either end, so that the ends are smoothed from both sides."""

NOISE_BAND = 0.7
"""Above this share of the Nyquist frequency a channel is taken to hold noise only."""

BANDS = 200
"""Logarithmic frequency bands over which the spectrum is averaged."""

CUT_GAIN, TELLING_BINS = 0.05, 8
"""From the first band with a smaller gain on, only what stands out of the noise is passed. A band of so many bins
tells: one bin alone, as the mean is, may be below the noise by chance."""
CHANCE = 0.01
"""Probability that noise stands out in any band: its periodogram, summed over k bins, has a gamma distribution. Beyond
the slow part of an oval's vy the driver's steering at 0.9 Hz comes after a gap, and is worth 0.25 m/s2 of ay."""


@dataclass(frozen=True)
class Smoothed:
    """A smoothed channel, its time derivative, and the standard deviations of what noise is left in them."""

    value: Array
    rate: Array
    noise: float
    """standard deviation of the noise of the channel as measured"""
    value_error: float
    rate_error: float
    bandwidth: float
    """Hz"""


def wiener(values: Array, step: float) -> Smoothed:
    """Smooth (n,) evenly sampled `values`; the noise level is the floor of their spectrum."""
    n = len(values)
    pad = min(n - 1, PAD)
    padded = np.concatenate([2 * values[0] - values[pad:0:-1], values, 2 * values[-1] - values[-2 : -pad - 2 : -1]])
    trend = np.linspace(padded[0], padded[-1], len(padded))
    spectrum = np.fft.rfft(padded - trend)
    frequency: Array = np.asarray(np.fft.rfftfreq(len(padded), step), float)
    gain, floor = _gain(spectrum, frequency)
    slope = (padded[-1] - padded[0]) / ((len(padded) - 1) * step)
    value = np.fft.irfft(spectrum * gain, len(padded)) + trend
    omega = 2.0 * np.pi * frequency
    rate = np.fft.irfft(1j * omega * spectrum * gain, len(padded)) + slope
    noise = float(np.sqrt(floor / len(padded)))
    return Smoothed(
        value=value[pad : pad + n],
        rate=rate[pad : pad + n],
        noise=noise,
        value_error=noise * float(np.sqrt(np.mean(gain))),
        rate_error=noise * float(np.sqrt(np.mean((omega * gain) ** 2))),
        bandwidth=float(frequency[gain > 0.5][-1]) if np.any(gain > 0.5) else 0.0,
    )


def _gain(spectrum: NDArray[np.complex128], frequency: Array) -> tuple[Array, float]:
    """Wiener gain S / (S + N) per frequency and the power N of the noise, from band averages of the periodogram."""
    power = np.abs(spectrum) ** 2
    high = frequency > NOISE_BAND * frequency[-1]
    floor = float(np.median(power[high])) / np.log(2.0)  # the median of an exponential distribution is ln 2 of its mean
    starts = np.unique(np.concatenate([[0], np.geomspace(1, len(power) - 1, BANDS).astype(int)]))
    counts = np.diff(np.append(starts, len(power)))
    bands = np.add.reduceat(power, starts) / counts
    gain = np.clip(1.0 - floor / np.maximum(bands, 1e-300), 0.0, 1.0)
    low = np.flatnonzero((gain < CUT_GAIN) & (counts >= TELLING_BINS))
    beyond = np.arange(len(gain)) >= (low[0] if low.size else len(gain))
    gain[beyond & (bands < floor * gammaincinv(counts, 1.0 - CHANCE / len(counts)) / counts)] = 0.0
    return np.repeat(gain, counts), floor


def smooth_velocity(velocity: Array, acceleration: Array, step: float) -> Smoothed:
    """Velocity along a body axis, with the kinematic `acceleration` (d/dt of it) an accelerometer suggests.

    The accelerometer is used only if it leaves less error than the velocity alone: one that lags or is wrong does not.
    """
    plain = wiener(velocity, step)
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (acceleration[1:] + acceleration[:-1]))]) * step
    slow = wiener(velocity - travelled, step)
    if slow.value_error >= plain.value_error:
        return plain
    return Smoothed(slow.value + travelled, plain.rate, plain.noise, slow.value_error, plain.rate_error, slow.bandwidth)


def second_difference_noise(values: Array) -> float:
    """Standard deviation of white noise in a signal that is smooth otherwise (robust: median)."""
    return float(np.median(np.abs(np.diff(values, 2))) / (0.6745 * np.sqrt(6.0)))
