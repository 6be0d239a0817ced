"""Figures of the identification report."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.model.tyre import AXLES, TyreAxle, force_derivatives, normalised_force
from estimator.offline.fit.equation_error import EquationErrorFit, residuals
from estimator.offline.fit.identifiability import slip_of
from estimator.offline.identification import Identification
from estimator.offline.result.identification_score import ALGEBRAIC_CHANNELS
from hil_gateway.dashboard.look import COLOURS, new_figure
from hil_gateway.process.arrays import Array

LABELS = {"ax": "ax, m/s²", "ay": "ay, m/s²", "yaw_acc": "yaw acceleration, rad/s²"}
STRETCH_S = 60.0
NORMAL_95 = 1.96
"""standard deviations on either side that hold 95 % of a normal distribution"""


def tyre_curves(result: Identification) -> Any:
    """Normalised lateral force of each axle before and after, with a 95 % band and the slip the data holds."""
    axles = AXLES[result.options.layout]
    figure, axes = new_figure(1, len(axles), (9.0, 3.3), squeeze=False, sharey=True)
    for axis, axle in zip(axes[0], axles, strict=True):
        slip = np.degrees(slip_of(axle, result.samples, result.vehicle))
        reach = max(1.6 * float(np.quantile(np.abs(slip), 0.999)), 1.0)
        alpha = np.linspace(-reach, reach, 301)
        _slip_shares(axis, slip, reach)
        low, high = curve_band(result.fit, axle, np.radians(alpha))
        axis.fill_between(alpha, low, high, color=COLOURS["after"], alpha=0.25, lw=0, label="95 %")
        before, after = (
            normalised_force(np.radians(alpha), *axle.of(values)) for values in (result.initial, result.final)
        )
        axis.plot(alpha, before, color=COLOURS["before"], ls="--", label="before")
        axis.plot(alpha, after, color=COLOURS["after"], label="after")
        top = 1.3 * float(np.abs([before, after]).max())
        title = f"{axle.name} axle" if axle.suffix else axle.name
        axis.set(title=title, xlabel="slip angle, deg", xlim=(-reach, reach), ylim=(-top, top))
    axes[0, 0].set_ylabel("lateral force / axle load")
    axes[0, 0].legend(loc="upper left", fontsize=8)
    return figure


def _slip_shares(axis: Any, slip: Array, reach: float) -> None:
    """Histogram of the slip angles, the highest bar as high as a force of half the load."""
    counts, edges = np.histogram(slip, bins=81, range=(-reach, reach))
    axis.stairs(0.5 * counts / counts.max(), edges, fill=True, color=COLOURS["muted"], alpha=0.45, label="slip in data")


def curve_band(fit: EquationErrorFit, axle: TyreAxle, alpha: Array) -> tuple[Array, Array]:
    """95 % interval (low, high), each (n,), of an axle's normalised force at the slip angles `alpha`, rad.

    By the delta method: the covariance of B, C and D through the curve's derivatives at the estimate. So the curve
    lies in the middle, and what is known only as a product (B C D at small slip) stays as narrow as it is known.
    """
    rows = list(axle.rows(fit.names))
    curve = fit.theta[rows]
    by_curve = force_derivatives(alpha, *curve)
    variance = np.einsum("ni,ij,nj->n", by_curve, fit.covariance[np.ix_(rows, rows)], by_curve)
    centre, half = normalised_force(alpha, *curve), NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))
    return centre - half, centre + half


def time_histories(result: Identification) -> Any:
    """Measured, predicted before and after over one held-out stretch: yaw rate and ay simulated, ax at the states."""
    held_out = result.samples.select(result.split.test)
    window = _stretch(held_out.t)
    figure, axes = new_figure(3, 1, (9.0, 5.6), sharex=True)
    before, after = (result.columns.predict(held_out.inputs, theta, ("ax",))[0] for theta in _thetas(result))
    _traces(axes[0], held_out.t[window], held_out.channels[0][window], before[window], after[window])
    axes[0].set_ylabel("ax, m/s²")
    first, second = result.rollouts
    order = np.argsort(first.index)
    t = held_out.t[first.index[order]]
    inside = _stretch(t)
    for axis, row, label in ((axes[1], 2, "ay, m/s²"), (axes[2], 1, "yaw rate, rad/s")):
        series = (first.measured[row], first.simulated[row], second.simulated[row])
        _traces(axis, t[inside], *(s[order][inside] for s in series))
        axis.set_ylabel(label)
    axes[0].legend(loc="upper right", ncols=3, fontsize=8)
    axes[2].set_xlabel("t, s")
    return figure


def _traces(axis: Any, t: Array, measured: Array, before: Array, after: Array) -> None:
    skip = max(1, len(t) // 2500)
    broken = np.where(np.diff(t[::skip], prepend=t[0]) > 0.5, np.nan, 1.0)
    for values, name, width in ((measured, "measured", 0.9), (before, "before", 0.8), (after, "after", 1.0)):
        axis.plot(t[::skip], values[::skip] * broken, color=COLOURS[name], lw=width, label=name, alpha=0.85)


def _stretch(t: Array) -> NDArray[np.bool_]:
    """The first held-out stretch, `STRETCH_S` of it."""
    return np.asarray((t >= t[0]) & (t <= t[0] + STRETCH_S))


def _thetas(result: Identification) -> tuple[Array, Array]:
    return result.columns.start, result.fit.theta


def learning_curve(result: Identification) -> Any:
    """RMSE of each channel over the batches or samples: refined, as published, and where the reported result stands."""
    figure, axes = new_figure(1, 3, (9.0, 2.7))
    recursion, by_sample = result.recursion, result.options.method == "sample"
    curves = {"refined": (recursion.curve, "after"), "as published": (recursion.as_published, "before")}
    for axis, channel in zip(axes, ALGEBRAIC_CHANNELS, strict=True):
        for name, (curve, colour) in curves.items():
            if curve:
                values = [p.rmse[channel] for p in curve]
                axis.plot([p.batch for p in curve], values, color=COLOURS[colour], label=name)
        reported = result.rmse_at_states[channel][1]
        axis.axhline(reported, color=COLOURS["measured"], linewidth=0.8, linestyle=":", label="reported")
        axis.set(title=LABELS[channel], xlabel="sample" if by_sample else "batch", ylim=(0, None))
    axes[0].set_ylabel("held-out RMSE")
    axes[0].legend(fontsize=8)
    return figure


def residual_spectra(result: Identification) -> Any:
    """Amplitude density of the held-out residuals before and after, of what was fitted."""
    from scipy.signal import welch

    series = _residual_series(result)
    figure, axes = new_figure(1, len(series), (9.0, 2.7))
    for axis, (label, pair) in zip(axes, series.items(), strict=True):
        for name, error in zip(("before", "after"), pair, strict=True):
            f, power = welch(error, 1.0 / result.samples.step, nperseg=min(1024, len(error)))
            axis.loglog(f[1:], np.sqrt(power[1:]), color=COLOURS[name], label=name)
        axis.set(title=label, xlabel="frequency, Hz")
    axes[0].set_ylabel("residual per √Hz")
    axes[0].legend(fontsize=8)
    return figure


def _residual_series(result: Identification) -> dict[str, tuple[Array, Array]]:
    """label -> residuals before and after: of the simulated windows where those were fitted."""
    held_out = result.samples.select(result.split.test)
    before, after = (residuals(result.columns, held_out, theta, ALGEBRAIC_CHANNELS) for theta in _thetas(result))
    series = {LABELS[c]: (before[i], after[i]) for i, c in enumerate(ALGEBRAIC_CHANNELS)}
    if result.formulation == "algebraic":
        return series
    first, second = ((r.measured - r.simulated)[:, np.argsort(r.index)] for r in result.rollouts)
    simulated = {"ay simulated, m/s²": (first[2], second[2]), "yaw rate simulated, rad/s": (first[1], second[1])}
    return {LABELS["ax"]: series[LABELS["ax"]], **simulated}


def correlations(result: Identification) -> Any:
    """Correlation matrix of the tyre estimates beside their relative standard deviations."""
    names = list(result.initial)
    index = [result.fit.names.index(n) for n in names]
    covariance = result.fit.covariance[np.ix_(index, index)]
    std = np.sqrt(np.diag(covariance))
    figure, (left, right) = new_figure(1, 2, (9.0, 3.0), gridspec_kw={"width_ratios": [1.2, 1.0]})
    image = left.imshow(covariance / np.outer(std, std), cmap="RdBu_r", vmin=-1, vmax=1)
    left.set_xticks(range(len(names)), names)
    left.set_yticks(range(len(names)), names)
    left.grid(False)
    figure.colorbar(image, ax=left, label="correlation")
    known = result.identifiability.identifiable
    colours = [COLOURS["after"] if known[n] else COLOURS["before"] for n in names]
    right.barh(names[::-1], (100 * std / np.abs(list(result.final.values())))[::-1], color=colours[::-1])
    right.set(xlabel="standard deviation, % of the value", title="blue: identified, red: not")
    right.set_xlim(0, min(100.0, 110.0 * float(np.max(std / np.abs(list(result.final.values()))))))
    return figure
