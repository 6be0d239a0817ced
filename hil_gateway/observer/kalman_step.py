"""One step of extended Kalman filters as a function: what a model predicts, and what each measurement says beyond it.

The model is written down once; CasADi derives the Jacobians, and the step of all filters of a bank is one call.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import casadi as ca

from hil_gateway.observer.kalman import symmetric
from hil_gateway.process.arrays import Expr
from hil_gateway.process.compiled import EXACT, CompiledFunction, compile_function


class Known(NamedTuple):
    """What is known of the states: mean (n,) and covariance (n, n)."""

    mean: Expr
    covariance: Expr

    def variance(self, linear: Expr, x: Expr) -> Expr:
        """Of a function of the states `x` that is nearly linear where they may be."""
        row = ca.substitute(ca.jacobian(linear, x), x, self.mean)
        return row @ self.covariance @ row.T


class StepModel(Protocol):
    """Motion and measurements in one period, as functions of n states `x`; `judged` of the measurements come last.
    What bends where the states may be is taken as the line that fits it best there."""

    states: int
    judged: int

    def after(self, x: Expr, known: Known) -> Expr:
        """States one period on, (n,)."""
        ...

    def noise(self, x: Expr, known: Known) -> Expr:
        """Variances that the period adds to the states, (n,)."""
        ...

    def shown(self, x: Expr, known: Known) -> tuple[Expr, ...]:
        """What the measurements are predicted to show."""
        ...

    def measured(self) -> tuple[Expr, ...]:
        """What they do show."""
        ...

    def variances(self, x: Expr, known: Known) -> tuple[Expr, ...]:
        """Of their noise in one sample."""
        ...


def step_function(name: str, model: StepModel, given: Expr, gate: float, filters: int) -> CompiledFunction:
    """(means (n, k), covariances (n, k n), given, uses (m, k)) of k filters to their next means and covariances; what
    the measurements show beyond what is predicted, in deviations of that (m, k); how the judged ones fit before they
    are taken in, as chi-square (1, k); and the negative log-likelihood of the others (1, k).

    `uses` are 1 where a measurement is taken in, 0 where it is only looked at. One that is not among the judged and
    further off than `gate` deviations is not taken in, and counts as that far off.
    """
    mean, covariance = ca.SX.sym("mean", model.states), ca.SX.sym("covariance", model.states, model.states)
    count = len(model.measured())
    uses = ca.SX.sym("uses", count)
    step = _Step(model, mean, covariance)
    step.predict()
    first = count - model.judged
    for i in range(first):
        step.update(i, uses[i], gate)
    fit, unlikely = step.fit(range(first, count)), ca.dot(uses[:first], step.unlikely(gate))
    for i in range(first, count):
        step.update(i, uses[i], ca.inf)
    found = [*step.known, ca.vertcat(*step.off), fit, unlikely]
    one = ca.Function(name, [mean, covariance, given, uses], [ca.densify(e) for e in found])
    return compile_function(one.map(f"{name}_bank", "serial", filters, [2], []), flags=EXACT)


class _Step:
    """Symbolic mean and covariance, moved on in place."""

    def __init__(self, model: StepModel, mean: Expr, covariance: Expr) -> None:
        self.model, self.known = model, Known(mean, covariance)
        self.off: list[Expr] = []
        """in deviations"""
        self._x = ca.SX.sym("x", model.states)

    def predict(self) -> None:
        """One period on."""
        after, F = self._around(self.model.after(self._x, self.known))
        noise = ca.diag(self._at(self.model.noise(self._x, self.known)))
        self.known = Known(after, symmetric(F @ self.known.covariance @ F.T + noise))

    def fit(self, measurements: range) -> Expr:
        """Chi-square of the measurements."""
        shown, rows = self._around(ca.vertcat(*(self.model.shown(self._x, self.known)[i] for i in measurements)))
        noise = ca.diag(self._at(ca.vertcat(*(self.model.variances(self._x, self.known)[i] for i in measurements))))
        off = ca.vertcat(*(self.model.measured()[i] for i in measurements)) - shown
        return off.T @ ca.inv(rows @ self.known.covariance @ rows.T + noise) @ off

    def update(self, i: int, use: Expr, gate: float) -> None:
        """Judge a measurement, and take it in where it is to be used and within the gate."""
        mean, covariance = self.known
        shown, H = self._around(self.model.shown(self._x, self.known)[i])
        off = self.model.measured()[i] - shown
        shared = covariance @ H.T
        total = H @ shared + self._at(self.model.variances(self._x, self.known)[i])
        deviation = ca.sqrt(total)
        gain = use * (ca.fabs(off) < gate * deviation) * shared / total
        self.known = Known(mean + gain * off, symmetric(covariance - gain @ shared.T))
        self.off.append(off / deviation)

    def unlikely(self, gate: float) -> Expr:
        """Negative log-likelihoods of what has been judged so far."""
        return ca.vertcat(*(0.5 * ca.fmin(off**2, gate**2) for off in self.off))

    def _at(self, function: Expr) -> Expr:
        """A function of the states at their mean."""
        return ca.substitute(function, self._x, self.known.mean)

    def _around(self, function: Expr) -> tuple[Expr, Expr]:
        """A function of the states at their mean, and its Jacobian there."""
        return self._at(function), self._at(ca.jacobian(function, self._x))
