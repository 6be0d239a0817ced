"""One step of extended Kalman filters as a function: what a model predicts, and what each measurement says beyond it.

The model is written down once; CasADi derives the Jacobians, and the step of all filters of a bank is one call.
"""

from __future__ import annotations

from typing import Protocol

import casadi as ca

from hil_gateway.observer.kalman import symmetric
from hil_gateway.process.arrays import Expr
from hil_gateway.process.compiled import EXACT, CompiledFunction, compile_function


class StepModel(Protocol):
    """Motion and measurements in one period, as functions of n `states`; `judged` of the measurements come last."""

    states: int
    judged: int

    def after(self, x: Expr) -> Expr:
        """States one period on, (n,)."""
        ...

    def noise(self, x: Expr) -> Expr:
        """Variances that the period adds to the states, (n,)."""
        ...

    def shown(self, x: Expr) -> tuple[Expr, ...]:
        """What the measurements are predicted to show."""
        ...

    def measured(self) -> tuple[Expr, ...]:
        """What they do show."""
        ...

    def variances(self, x: Expr) -> tuple[Expr, ...]:
        """Of their noise in one sample."""
        ...


def step_function(name: str, model: StepModel, given: Expr, gate: float, filters: int) -> CompiledFunction:
    """(means (n, k), covariances (n, k n), given, uses (m, k)) of k filters to their next means and covariances; what
    the measurements show beyond what is predicted, in deviations of that (m, k); and how the judged ones fit before
    they are taken in, as chi-square (1, k).

    `uses` are 1 where a measurement is taken in, 0 where it is only looked at. One that is not among the judged and
    further off than `gate` deviations is not taken in.
    """
    mean, covariance = ca.SX.sym("mean", model.states), ca.SX.sym("covariance", model.states, model.states)
    count = len(model.measured())
    uses = ca.SX.sym("uses", count)
    step = _Step(model, mean, covariance)
    step.predict()
    first = count - model.judged
    for i in range(first):
        step.update(i, uses[i], gate)
    fit = step.fit(range(first, count))
    for i in range(first, count):
        step.update(i, uses[i], ca.inf)
    found = [step.mean, step.covariance, ca.vertcat(*step.off), fit]
    one = ca.Function(name, [mean, covariance, given, uses], [ca.densify(e) for e in found])
    return compile_function(one.map(f"{name}_bank", "serial", filters, [2], []), flags=EXACT)


class _Step:
    """Symbolic mean and covariance, moved on in place."""

    def __init__(self, model: StepModel, mean: Expr, covariance: Expr) -> None:
        self.model, self.mean, self.covariance = model, mean, covariance
        self.off: list[Expr] = []
        """in deviations"""

    def predict(self) -> None:
        """One period on."""
        after, noise = self.model.after(self.mean), self.model.noise(self.mean)
        F = ca.jacobian(after, self.mean)
        self.covariance = symmetric(F @ self.covariance @ F.T + ca.diag(noise))
        self.mean = after

    def fit(self, measurements: range) -> Expr:
        """Chi-square of the measurements."""
        rows = ca.vertcat(*(self._row(i) for i in measurements))
        noise = ca.diag(ca.vertcat(*(self.model.variances(self.mean)[i] for i in measurements)))
        seen, shown = (
            ca.vertcat(*(values[i] for i in measurements))
            for values in (self.model.shown(self.mean), self.model.measured())
        )
        certainty = ca.inv(rows @ self.covariance @ rows.T + noise)
        off = shown - seen
        return off.T @ certainty @ off

    def update(self, i: int, use: Expr, gate: float) -> None:
        """Judge a measurement, and take it in where it is to be used and within the gate."""
        off = self.model.measured()[i] - self.model.shown(self.mean)[i]
        H, variance = self._row(i), self.model.variances(self.mean)[i]
        shared = self.covariance @ H.T
        total = H @ shared + variance
        deviation = ca.sqrt(total)
        gain = use * (ca.fabs(off) < gate * deviation) * shared / total
        self.mean = self.mean + gain * off
        self.covariance = symmetric(self.covariance - gain @ shared.T)
        self.off.append(off / deviation)

    def _row(self, i: int) -> Expr:
        """Row of the Jacobian of a measurement here, (1, n)."""
        x = ca.SX.sym("x", self.mean.numel())
        return ca.substitute(ca.jacobian(self.model.shown(x)[i], x), x, self.mean)
