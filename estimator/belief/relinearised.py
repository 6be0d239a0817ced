"""Tyre belief that linearises again what it has learnt from: Eq. (8) iterated over a thinned history.

Eq. (8) takes the Jacobian of a sample at the mean of that moment and keeps it for ever. B, C and D act alike at small
slip, so the directions linearised along an early mean differ from those along a later one, and their sum looks like
knowledge of all three: on laps below the limit the covariance of C shrank to a fifth of what the data held, around a
mean five standard deviations off. Here Gauss-Newton steps over the history, all Jacobians at the present mean, take
the place of mean and covariance once a second (iterated Kalman smoother: Bell and Cathey 1993); in between Eq. (8)
runs with the Jacobians at the mean of the last step. At the running mean they turn with it: within one second in a
bend it ran away by two standard deviations, each step confirming the last.

The history also tells how independent the errors are. Where a car has what Eq. (1)-(3) leave out, they keep their sign
for a bend or a straight, and counting them as noise ends in false parameters that are stated to be exact: a rear peak
of 0.59 +- 0.04 where 1.6 is true. So a channel's samples count as many times less as the mean of its errors over some
seconds is larger than their independence allows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.belief.tyre_belief import BeliefSettings, Sample, TyreBelief
from estimator.model.single_track import SingleTrack
from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import CompiledFunction

EVERY = 100
"""samples between two linearisations"""
CAPACITY = 200
"""samples in the history; when it is full every other one is dropped and the rest count twice, each for up to
one independent sample"""
FIRST_THINNING = 10
"""of the samples at 100 Hz one in so many is kept at first"""
STEPS = 2
"""each time; with one the mean was still on its way from where Eq. (8) had led it"""
STRETCH = 500
"""samples, 5 s: as long as a bend or a straight, over which what the model leaves out keeps its sign"""
SHARED = [2, 4]
"""which inputs of the measurement model all samples have in common: theta and the car"""
TINY = 1e-12
SHARES = (1.0, 0.5, 0.25)
"""of a step that are tried"""


class RelinearisedBelief(TyreBelief):
    """`TyreBelief` with a history; costs some ms once a second."""

    def __init__(
        self, model: SingleTrack, settings: BeliefSettings | None = None, effects: Array | None = None
    ) -> None:
        self._history: list[tuple[Sample, Array]] = []
        super().__init__(model, settings, effects)
        self._start_precision: Array = np.eye(len(self.names))

    def reset(self) -> None:
        """Back to the prior, with nothing learnt from."""
        super().reset()
        self._history, self._thinning = [], FIRST_THINNING
        self._at: Array | None = None
        self._dependent = np.ones(len(self.channel_variance))

    def set_covariance(self, covariance: Array) -> None:
        """Start from a known covariance of theta, SI, instead of the prior's."""
        super().set_covariance(covariance)
        self._start_precision = np.asarray(np.linalg.pinv(self.scaled_covariance), dtype=np.float64)

    def update(self, sample: Sample, dt: float = 0.01) -> Array:
        """Eq. (8) for one sample; at times the history is linearised again."""
        before = self.samples
        nis = super().update(sample, dt)
        if self.samples == before:
            return nis
        if self.samples % self._thinning == 0:
            self._keep(sample)
        if self.samples % EVERY == 0:
            self._relinearise()
        return nis

    def _linearised_at(self) -> Array:
        return self.deviation if self._at is None else self._at

    def _error_variance(self) -> Array:
        return self.channel_variance * self._dependent

    def _keep(self, sample: Sample) -> None:
        self._history.append((sample, self._active_channels(sample).astype(float)))
        if len(self._history) >= CAPACITY:
            self._history, self._thinning = self._history[1::2], 2 * self._thinning

    def _relinearise(self) -> None:
        if self._history:
            # a kept sample stands for those dropped, but for no more than one independent one
            count = min(self._thinning, self.settings.correlation_samples)
            weight = np.array([count * active for _, active in self._history])
            history = _Stacked(self._model, [sample for sample, _ in self._history], weight)
            for _ in range(STEPS):
                self._step(history)
            self._at = self.deviation

    def _step(self, history: _Stacked) -> None:
        """A Gauss-Newton step of the maximum a posteriori estimate over the history, halved while it leads uphill."""
        residual, H, variance = self._linearised(history, self.deviation)
        weight = history.weight * (residual**2 <= self.settings.gate_sigma**2 * variance) / variance
        self._dependent = self._dependence(self._unexplained(residual, H, weight), H, weight)
        weight /= self._dependent
        precision = self._start_precision + np.einsum("kci,kc,kcj->ij", H, weight, H)
        gradient = np.einsum("kci,kc,kc->i", H, weight, residual) - self._start_precision @ self.deviation
        covariance = np.linalg.inv(precision)
        step = covariance @ gradient
        if not (np.isfinite(step).all() and np.isfinite(covariance).all()):
            return
        self.scaled_covariance = 0.5 * (covariance + covariance.T)
        present = self._cost(residual, weight, self.deviation)
        for share in SHARES:
            deviation = np.clip(self.deviation + share * step, self.lower, self.upper)
            if self._cost(self._residual(history, deviation), weight, deviation) < present:
                self.deviation = deviation
                return

    def _unexplained(self, residual: Array, H: Array, weight: Array) -> Array:
        """What a linear refit of all samples at `weight` leaves of the errors (K, m).

        Errors that other parameters take away say nothing of how independent the rest is. Counted as dependent they
        take the weight from the very samples that ask for other parameters, and the prior keeps the old ones.
        """
        precision = self._start_precision + np.einsum("kci,kc,kcj->ij", H, weight, H)
        gradient = np.einsum("kci,kc,kc->i", H, weight, residual) - self._start_precision @ self.deviation
        return np.asarray(residual - H @ np.linalg.solve(precision, gradient))

    def _dependence(self, residual: Array, H: Array, weight: Array) -> Array:
        """How many times fewer independent samples than assumed the errors (K, m) of each channel amount to, (m,) >= 1;
        the errors are those of the best parameters (`_unexplained`).

        The gradients of the squared errors in theta, summed over a stretch of independent errors, have the stretch's
        information for covariance. What they have in truth is taken from the history, as in the covariance of
        clustered errors (Liang and Zeger 1986), but per channel and in the trace: enough to weigh a channel less.
        """
        length = max(1, STRETCH // self._thinning)
        rest = len(residual) % length

        def per_stretch(values: Array) -> Array:
            return np.asarray(values[rest:].reshape(-1, length, *values.shape[1:]).sum(axis=1))

        gradients = per_stretch((weight * residual)[:, :, None] * H)
        expected = per_stretch(weight * np.sum(H**2, axis=2))
        total = expected.sum(axis=0) + TINY
        # as many stretches of equal information would scatter alike; median of chi squared (Wilson and Hilferty 1931)
        freedom = np.maximum(total**2 / (np.sum(expected**2, axis=0) + TINY), 1.0)
        by_chance = (1.0 - 2.0 / (9.0 * freedom)) ** 3
        return np.asarray(np.maximum(np.sum(gradients**2, axis=(0, 2)) / total / by_chance, 1.0))

    def _cost(self, residual: Array, weight: Array, deviation: Array) -> float:
        return float(np.sum(weight * residual**2) + deviation @ self._start_precision @ deviation)

    def _residual(self, history: _Stacked, deviation: Array) -> Array:
        """What the model leaves of the history at a scaled deviation, (K, m)."""
        h, *_ = history.modelled(self.prior + self.scale * deviation)
        return np.asarray(history.z - h.T)

    def _linearised(self, history: _Stacked, deviation: Array) -> tuple[Array, Array, Array]:
        """Residuals (K, m), Jacobians in scaled parameters (K, m, n) and variances (K, m) at a scaled deviation."""
        count, channels = history.z.shape
        h, *jacobians = history.modelled(self.prior + self.scale * deviation)
        # the Jacobians of all samples come side by side
        by_theta, by_signals = (j.reshape(channels, count, -1).transpose(1, 0, 2) for j in jacobians)
        motion = by_signals[:, :, :3]
        variance = self.channel_variance + np.einsum("kci,kij,kcj->kc", motion, history.spread, motion)
        variance += np.einsum("kci,ki->kc", by_signals[:, :, 3:] ** 2, history.acting)
        return history.z - h.T, by_theta * self.scale, variance


class _Stacked:
    """Samples as arrays: columns for the measurement `model`, rows for everything else; `weight` is (K, m)."""

    def __init__(self, model: CompiledFunction, samples: Sequence[Sample], weight: Array) -> None:
        of_all = model.function.map("of_all", "serial", len(samples), SHARED, [])
        self._model = CompiledFunction(of_all, model.backend)
        signals, aux, _, phi, vehicle = self._model.inputs
        signals[:], aux[:], phi[:] = (
            np.array([getattr(s, name) for s in samples]).T.reshape(-1, len(samples))
            for name in ("signals", "aux", "phi")
        )
        vehicle[:] = model.inputs[-1]
        self.z = np.array([s.z for s in samples])
        self.spread = np.array([s.signal_covariance for s in samples])
        self.acting = np.array([s.input_variance for s in samples])
        self.weight = weight

    def modelled(self, theta: Array) -> list[Array]:
        """What the model says of all samples with these parameters, SI, and its Jacobians in theta and signals."""
        self._model.arguments[2][:] = theta
        self._model.evaluate()
        return [np.ascontiguousarray(found) for found in self._model.outputs]
