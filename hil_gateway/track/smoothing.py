"""From surveyed points to a smooth track.

Surveyed points scatter, and curvature, a second derivative, would amplify the scatter. Every track therefore
passes a periodic smoothing spline: trigonometric basis, penalty on the third derivative, strength chosen by
generalised cross-validation (G. Wahba, Spline Models for Observational Data, SIAM 1990, ch. 2 and 4). On an equal
grid each Fourier coefficient at wave number k is divided by 1 + (k / k_c)^6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil_gateway.process.arrays import Array, Complex
from hil_gateway.process.errors import InputError
from hil_gateway.track.pit_lane import LaneSurvey, lane_along
from hil_gateway.track.track import SPACING_M, Track

ROAD_WIDTH_M = 10.0
"""Width of a road for full-size cars, for which the lengths below are meant; on a narrower one, which smaller cars
drive, all of them are smaller in proportion"""
TOLERANCE_M = 1.0
"""root mean square distance beyond which the points and a smooth line are not the same track"""
SHORTEST_WAVE_M = 25.0
"""undulations shorter than this are survey noise, never road"""
LONGEST_WAVE_M = 160.0
"""strongest smoothing tried"""
TRIALS = 40
JAGGED_RAD = 0.15
"""median turn between successive chords beyond which points lie closer together than they scatter"""
POINTS_DENSE = 200


@dataclass(frozen=True)
class Survey:
    """Points of a track as a file gives them, shape (n,) each; `source` names the file in messages."""

    source: str
    name: str
    x: Array
    y: Array
    width_left: Array
    width_right: Array
    z: Array
    bank: Array
    pit_lane: LaneSurvey | None = None

    @property
    def scale(self) -> float:
        """Size of the track over that of one for full-size cars, at most 1."""
        return min(1.0, float(np.median(self.width_left + self.width_right)) / ROAD_WIDTH_M)


def smooth(survey: Survey) -> Track:
    """Track through the points of a survey.

    Raises:
        InputError: the smooth line leaves the points by more than `TOLERANCE_M`, less on a narrow track.
    """
    from scipy.interpolate import CubicSpline

    while len(survey.x) > POINTS_DENSE and _jagged(survey.x, survey.y):
        survey = _pairs_averaged(survey)
    parameter = _chord_length(survey.x, survey.y)
    period = float(parameter[-1])
    n = len(survey.x)
    grid = np.arange(n) * (period / n)
    planar = np.vstack([survey.x, survey.y])
    raw = CubicSpline(parameter, _wrap(planar), axis=1, bc_type="periodic")(grid)
    coefficients, removed = _cross_validated(np.fft.rfft(raw), period, n, survey.scale)
    if removed > (limit := TOLERANCE_M * survey.scale):
        raise InputError(
            f"{survey.source}: points scatter by {removed:.2f} m around a smooth line (limit {limit:.2g} m);"
            " are they in order, and from one lap?"
        )
    profiles = np.vstack([survey.z, survey.bank, survey.width_left, survey.width_right])
    along = np.interp(grid, parameter, np.arange(n + 1.0))
    raw_levels = np.vstack([np.interp(along, np.arange(n + 1.0), row) for row in _wrap(profiles)])
    smoothed = [_cross_validated(np.fft.rfft(row[None, :]), period, n, survey.scale)[0][0] for row in raw_levels]
    levels = np.vstack([np.fft.irfft(spectrum, n) for spectrum in smoothed])
    track = _resample(survey, coefficients, levels, period, removed)
    return track if survey.pit_lane is None else replace(track, pit_lane=lane_along(track, survey.pit_lane))


def _jagged(x: Array, y: Array) -> bool:
    heading = np.arctan2(np.diff(y, append=y[:1]), np.diff(x, append=x[:1]))
    turn = np.angle(np.exp(1j * np.diff(heading)))
    return bool(np.median(np.abs(turn)) > JAGGED_RAD)


def _pairs_averaged(survey: Survey) -> Survey:
    """Half as many points: dense points that scatter have no usable chord length."""
    even = len(survey.x) // 2 * 2
    names = ("x", "y", "width_left", "width_right", "z", "bank")
    return replace(survey, **{name: getattr(survey, name)[:even].reshape(-1, 2).mean(axis=1) for name in names})


def _wrap(rows: Array) -> Array:
    """Rows with their first column repeated at the end."""
    return np.hstack([rows, rows[:, :1]])


def _chord_length(x: Array, y: Array) -> Array:
    """Cumulative chord length of the closed polygon, shape (n + 1,)."""
    steps = np.hypot(np.diff(x, append=x[:1]), np.diff(y, append=y[:1]))
    return np.concatenate([[0.0], np.cumsum(steps)])


def _wave_numbers(n: int, period: float) -> Array:
    return np.asarray(2.0 * np.pi / period * np.arange(n // 2 + 1), dtype=float)


def _cross_validated(spectrum: Complex, period: float, n: int, scale: float) -> tuple[Complex, float]:
    """Smoothed spectrum of the rows together, and the root mean square of what was taken away (m).

    Generalised cross-validation score: n RSS / (n - trace of the smoother)^2.
    """
    k = _wave_numbers(n, period)
    multiplicity = np.where((k > 0) & (np.arange(len(k)) * 2 != n), 2.0, 1.0)
    power = (np.abs(spectrum) ** 2).sum(axis=0) * multiplicity / n
    best: tuple[float, Array, float] | None = None
    for wave in np.geomspace(scale * SHORTEST_WAVE_M, min(scale * LONGEST_WAVE_M, period / 4.0), TRIALS):
        gain = 1.0 / (1.0 + (k * wave / (2.0 * np.pi)) ** 6)
        residual = float(np.sum(power * (1.0 - gain) ** 2))
        score = residual / max(1.0 - float(np.sum(multiplicity * gain)) / n, 1e-9) ** 2
        if best is None or score < best[0]:
            best = (score, gain, float(np.sqrt(residual / n)))
    assert best is not None
    return spectrum * best[1], best[2]


def _resample(survey: Survey, spectrum: Complex, levels: Array, period: float, deviation: float) -> Track:
    """Evaluate the smooth line at equal steps of arc length, with exact derivatives of the trigonometric basis."""
    n = levels.shape[1]
    k = _wave_numbers(n, period)
    fine = max(8 * n, int(4 * period / (survey.scale * SPACING_M)))
    u = np.arange(fine) * (period / fine)

    def derivative(order: int) -> Array:
        return np.asarray(np.fft.irfft(spectrum * (1j * k) ** order, fine) * (fine / n))

    (x, y), (dx, dy), (ddx, ddy) = derivative(0), derivative(1), derivative(2)
    speed = np.hypot(dx, dy)
    length = float(speed.mean() * period)
    s_fine = np.concatenate([[0.0], np.cumsum(0.5 * (speed + np.roll(speed, -1)) * (period / fine))])
    count = int(np.ceil(length / (survey.scale * SPACING_M)))
    s = np.linspace(0.0, length, count, endpoint=False)
    at = np.interp(s, s_fine, np.append(u, period))

    def sample(values: Array) -> Array:
        return np.asarray(np.interp(at, np.append(u, period), np.append(values, values[0])))

    heading = np.unwrap(np.arctan2(dy, dx))
    turning = 2.0 * np.pi * np.round((heading[-1] - heading[0]) / (2.0 * np.pi))
    profiles = [
        _level(np.interp(at, np.arange(n + 1) * (period / n), row), length, survey.scale) for row in _wrap(levels)
    ]
    z, bank, width_left, width_right = (value for value, _ in profiles)
    return Track(
        name=survey.name,
        x=sample(x),
        y=sample(y),
        s=s,
        width_left=width_left,
        width_right=width_right,
        z=z,
        bank=bank,
        heading=np.asarray(np.interp(at, np.append(u, period), np.append(heading, heading[0] + turning))),
        curvature=sample((dx * ddy - dy * ddx) / speed**3),
        grade=np.arctan(profiles[0][1]),
        length=length,
        deviation=deviation,
    )


def _level(values: Array, length: float, scale: float) -> tuple[Array, Array]:
    """Smoothed periodic profile and its derivative over arc length."""
    n = len(values)
    k = _wave_numbers(n, length)
    spectrum = np.fft.rfft(values) / (1.0 + (k * scale * SHORTEST_WAVE_M / (2.0 * np.pi)) ** 6)
    return np.asarray(np.fft.irfft(spectrum, n)), np.asarray(np.fft.irfft(spectrum * 1j * k, n))
