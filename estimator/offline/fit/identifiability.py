"""What the data determines and what not: Fisher information (Eq. 6, 7), its criteria, and its weak directions in words.

The analysis is in logarithms of B, C and D, so that a direction means a relative change of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.belief.information import a_criterion, d_criterion, e_criterion, trace_criterion
from estimator.model.parameters import Layout
from estimator.model.tyre import AXLES, CURVE, TyreAxle, force_derivatives, slip_at_peak
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.record.prepare import Samples, slip_angles
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

KNOWN_TO = 0.15
"""A parameter counts as identified when the data alone gives its relative standard deviation below this."""

IMPLAUSIBLE = 5.0
"""Prior standard deviations from the prior beyond which a value is not believed, however precise."""

EXCITATION_STEPS = tuple(1.0 + 0.1 * k for k in range(1, 91))
"""Factors on the slip angles tried to find how much more excitation would do."""


@dataclass(frozen=True)
class Axle:
    """One axle's slip and what it tells; angles in rad.

    `relative_std` of B, C, D from this axle's lateral force alone; `needed_slip` is the 99th percentile of |slip|
    at which all three would be known to `KNOWN_TO` (None: they are, or no excitation tried would do).
    """

    name: str
    slip_99: float
    slip_at_peak: float
    relative_std: dict[str, float]
    condition_number: float
    needed_slip: float | None


@dataclass(frozen=True)
class Identifiability:
    """Criteria of the scaled Fisher information of the tyre parameters, and conclusions.

    `identifiable` per parameter; `statements` in words, weakest combination first; `data_std` relative standard
    deviation of each parameter from the data alone, without the prior; `stiffness_std` that of B C D of each axle.
    """

    trace: float
    d_criterion: float
    a_criterion: float
    e_criterion: float
    condition_number: float
    data_std: dict[str, float]
    identifiable: dict[str, bool]
    statements: tuple[str, ...]
    axles: tuple[Axle, ...]
    stiffness_std: dict[str, float]


def analyse(
    fit: EquationErrorFit, samples: Samples, vehicle: Vehicle, layout: Layout, vy_off: float = 0.0
) -> Identifiability:
    """Identifiability of the tyre parameters at the estimate of `fit`; `vy_off`: m by which vy may be misplaced."""
    tyre = [i for i, name in enumerate(fit.names) if "." not in name]
    names = [fit.names[i] for i in tyre]
    scaled = marginal_information(fit.information, tyre)
    theta, scale = fit.theta[tyre], np.array([fit.parameters[i].prior_std for i in tyre])
    inflation = _inflation(fit, tyre)
    relative = theta / scale
    logarithmic = scaled * np.outer(relative, relative) / np.sqrt(np.outer(inflation, inflation))
    by_place = {axle.name: vy_off * _per_metre(axle, samples, vehicle) for axle in AXLES[layout]}
    data_std = _data_std(logarithmic, names, fit.at_bound)
    for axle in AXLES[layout]:
        data_std[axle.parameters[0]] = float(np.hypot(data_std[axle.parameters[0]], by_place[axle.name]))
    identifiable = _identifiable(data_std, (*fit.at_bound, *_implausible(fit)))
    axles = tuple(_axle(axle, fit, samples, vehicle) for axle in AXLES[layout])
    known_product = {a.name: float(np.hypot(_product_std(logarithmic, names, a), by_place[a.name])) for a in axles}
    return Identifiability(
        trace=trace_criterion(scaled),
        d_criterion=d_criterion(scaled),
        a_criterion=a_criterion(scaled),
        e_criterion=e_criterion(scaled),
        condition_number=float(np.linalg.cond(logarithmic)),
        data_std=data_std,
        identifiable=identifiable,
        statements=(
            *_of_drive(fit, identifiable),
            *_of_place(by_place, vy_off),
            *_in_words(identifiable, known_product, axles),
            *_at_bounds(fit),
        ),
        axles=axles,
        stiffness_std=known_product,
    )


def marginal_information(information: Array, kept: Sequence[int]) -> Array:
    """Information about `kept` when the other parameters are unknown: their Schur complement."""
    rest = [i for i in range(len(information)) if i not in kept]
    A = information[np.ix_(kept, kept)]
    if not rest:
        return A
    B, C = information[np.ix_(kept, rest)], information[np.ix_(rest, rest)]
    return np.asarray(A - B @ np.linalg.pinv(C, hermitian=True) @ B.T)


def _inflation(fit: EquationErrorFit, tyre: list[int]) -> Array:
    """By how much correlated residuals inflate the variance of each tyre parameter: sandwich over plain."""
    scale = np.array([p.prior_std for p in fit.parameters])
    plain = np.diag(_inverse(fit.information + np.eye(len(scale)))) * scale**2
    return np.asarray(np.maximum(1.0, np.diag(fit.covariance)[tyre] / plain[tyre]))


def _inverse(matrix: Array) -> Array:
    """Inverse of an information matrix; directions without information get a huge but finite variance."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors / np.maximum(values, 1e-12 * max(float(values[-1]), 1e-300))) @ vectors.T)


def _data_std(logarithmic: Array, names: list[str], at_bound: Sequence[str]) -> dict[str, float]:
    """Relative standard deviation of each parameter from the data alone; one on its bound is taken as given there."""
    free = [i for i, name in enumerate(names) if name not in at_bound]
    std = np.full(len(names), np.inf)
    std[free] = np.sqrt(np.maximum(np.diag(_inverse(logarithmic[np.ix_(free, free)])), 0.0))
    return dict(zip(names, std.tolist(), strict=True))


def _implausible(fit: EquationErrorFit) -> tuple[str, ...]:
    """Tyre parameters so far from their prior that they stand for something the model lacks."""
    far = {p.name: abs(v - p.prior) / p.prior_std for p, v in zip(fit.parameters, fit.theta, strict=True)}
    return tuple(name for name, distance in far.items() if distance > IMPLAUSIBLE and "." not in name)


def _identifiable(data_std: dict[str, float], at_bound: Sequence[str]) -> dict[str, bool]:
    """An axle with a parameter on its bound, or implausible, is not identified: the data did not set it."""
    stuck = {name[1:] for name in at_bound if name[0] in CURVE and "." not in name}
    return {n: s < KNOWN_TO and not (n != "cx" and n[1:] in stuck) and n not in at_bound for n, s in data_std.items()}


def _product_std(logarithmic: Array, names: list[str], axle: Axle) -> float:
    """Relative standard deviation of the cornering stiffness B C D of an axle."""
    direction = np.array([1.0 if _on(axle, name) else 0.0 for name in names])
    return float(np.sqrt(direction @ _inverse(logarithmic) @ direction))


def _per_metre(axle: TyreAxle, samples: Samples, vehicle: Vehicle) -> float:
    """Relative change of the stiffness of an axle by a metre that vy is measured off the CoG."""
    slip = slip_of(axle, samples, vehicle)
    seen = np.resize(samples["yaw_rate"] / samples["vx"], slip.shape)
    return float(abs(slip @ seen) / (slip @ slip))


def _of_place(by_place: dict[str, float], vy_off: float) -> list[str]:
    text = "the cornering stiffness of {} may be off by {:.0f} %, as vy may be measured {:.1f} m off the CoG"
    return [text.format(name, 100 * share, vy_off) for name, share in by_place.items() if share > KNOWN_TO]


def _of_drive(fit: EquationErrorFit, identifiable: dict[str, bool]) -> list[str]:
    if identifiable["cx"]:
        return []
    contradicted = "cx" in fit.at_bound
    why = "the acceleration does not follow the drive signal" if contradicted else "too little driving and braking"
    return [f"C_x is not determined: {why}"]


def _in_words(identifiable: dict[str, bool], known_product: dict[str, float], axles: tuple[Axle, ...]) -> list[str]:
    statements = []
    for axle in axles:
        unknown = [n[0].upper() for n in sorted(identifiable, key=_importance) if _on(axle, n) and not identifiable[n]]
        if unknown:
            statements.append(_of_axle(axle, unknown, known_product[axle.name]))
    return statements


def _importance(name: str) -> int:
    """D before C before B, as engineers name them."""
    return "".join(reversed(CURVE)).find(name[0])


def _of_axle(axle: Axle, letters: list[str], product: float) -> str:
    where = "" if axle.name == "both axles" else f" of the {axle.name} axle"
    if len(letters) == 1:
        what = f"{letters[0]}{where} is not determined"
    else:
        what = f"{', '.join(letters[:-1])} and {letters[-1]}{where} cannot be separated"
    text = f"{what}: largest slip {np.degrees(axle.slip_99):.1f} deg (99th percentile)"
    if axle.needed_slip is not None:
        text += f", about {np.degrees(axle.needed_slip):.1f} deg would separate them"
    if product < KNOWN_TO:
        text += f"; their product, the cornering stiffness, is known to {100 * product:.2g} %"
    return text


def _on(axle: Axle, name: str) -> bool:
    return name != "cx" and (len(name) == 1 or name[1] == axle.name[0])


def _at_bounds(fit: EquationErrorFit) -> list[str]:
    text = "{} = {:.4g} {}: it is not exported"
    stuck = [text.format(n, fit.values[n], "ended on its bound") for n in fit.at_bound if "." not in n]
    far = [text.format(n, fit.values[n], "is too far from its prior to be believed") for n in _implausible(fit)]
    return stuck + far


def _axle(axle: TyreAxle, fit: EquationErrorFit, samples: Samples, vehicle: Vehicle) -> Axle:
    B, C, D = _curve_of(axle, fit)
    alpha = slip_of(axle, samples, vehicle)
    alpha = alpha[:: max(1, len(alpha) // 5000)]
    std, condition = _curve_std(alpha, B, C, D)
    slip_99 = float(np.quantile(np.abs(alpha), 0.99))
    return Axle(
        name=axle.name,
        slip_99=slip_99,
        slip_at_peak=slip_at_peak(B, C),
        relative_std=dict(zip(CURVE, std.tolist(), strict=True)),
        condition_number=condition,
        needed_slip=_needed(alpha, B, C, D, slip_99) if std.max() > KNOWN_TO else None,
    )


def slip_of(axle: TyreAxle, samples: Samples, vehicle: Vehicle) -> Array:
    """Slip angles, rad, (n,) of an axle, or (2 n,) of both."""
    front, rear = slip_angles(samples, vehicle)
    return {"f": front, "r": rear}.get(axle.suffix, np.concatenate([front, rear]))


def _curve_of(axle: TyreAxle, fit: EquationErrorFit) -> tuple[float, float, float]:
    """B, C, D of an axle; where one is on its bound, the prior's C and D with the stiffness that was found."""
    B, C, D = axle.of(fit.values)
    if not any(name in fit.at_bound for name in axle.parameters):
        return B, C, D
    _, prior_c, prior_d = axle.of({p.name: p.prior for p in fit.parameters})
    return B * C * D / (prior_c * prior_d), prior_c, prior_d


FORCE_NOISE = 0.03
"""Noise of the lateral force over axle load taken for the excitation advice: 0.3 m/s2, model error included."""

INDEPENDENT_PER_LOG = 500.0
"""Independent samples a log is worth for the same advice, whatever its rate."""


def _curve_std(alpha: Array, B: float, C: float, D: float) -> tuple[Array, float]:
    """Relative standard deviations of B, C, D from force samples at `alpha`, and the information's condition number."""
    curve = np.array([B, C, D])
    J = (force_derivatives(alpha, *curve) * curve).T / FORCE_NOISE
    information = J @ J.T * (INDEPENDENT_PER_LOG / len(alpha))
    return np.sqrt(np.diag(_inverse(information))), float(np.linalg.cond(information))


def _needed(alpha: Array, B: float, C: float, D: float, slip_99: float) -> float | None:
    for factor in EXCITATION_STEPS:
        if _curve_std(alpha * factor, B, C, D)[0].max() < KNOWN_TO:
            return factor * slip_99
    return None
