"""Gaussian belief over the tyre parameters, updated sample by sample with Eq. (8).

The recursion runs on parameters scaled by their prior standard deviation, so the prior covariance is the identity.
Sigma_z is diagonal, which makes Eq. (8) equal to one scalar update a channel; each is in Joseph form, so the
covariance stays symmetric positive semi-definite whatever the rounding. What the model says is one CasADi function,
the recursion another one; both are compiled for all cars.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import atan2, sqrt
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from estimator.model.measurement import CHANNELS, MeasurementKind, compiled_for, measurement_function, of_any_car
from estimator.model.single_track import SIGNALS, SingleTrack
from hil_gateway.observer.kalman import scalar_update
from hil_gateway.process.arrays import Array, finite
from hil_gateway.process.compiled import EXACT_LOOPS, CompiledFunction, compile_function

MEASURED: Mapping[str, float] = {
    "imu_ax": 0.5, "imu_ay": 0.4, "yaw_acc": 0.4, "fx_r": 0.5, "fy_f": 0.32, "fy_r": 0.32,
}  # fmt: skip
"""Measurement standard deviations, m/s2 and rad/s2: sensor noise, what Eq. (1)-(3) leave out; forces over the mass"""

PLAUSIBLE = 1e6
"""no signal or measurement of a car is larger in SI; what is, is broken"""


@dataclass(frozen=True)
class BeliefSettings:
    """Noise, gates and bounds of the recursion.

    `correlation_samples` is over how many samples model errors stay correlated: the information of one sample is
    divided by it, which keeps the covariance honest at 100 Hz. `drift` is the random walk of the scaled parameters
    per square root of a second.
    """

    kind: MeasurementKind = "imu_yaw"
    std: Mapping[str, float] | None = None
    correlation_samples: float = 50.0
    drift: float = 0.0
    gate_sigma: float = 5.0
    min_speed: float = 8.0
    min_slip: float = 0.002
    min_drive: float = 0.01
    max_slip_std: float = 0.02

    def channel_std(self, mass: float) -> Array:
        """Standard deviation of each row of z, inflated for serial correlation."""
        usual = dict(zip(CHANNELS[self.kind], measured_std(self.kind, mass), strict=True))
        return np.array([*(usual | dict(self.std or {})).values()]) * float(np.sqrt(self.correlation_samples))


def measured_std(kind: MeasurementKind, mass: float) -> list[float]:
    """`MEASURED` of each row of z, SI."""
    return [MEASURED[c] * (mass if c.startswith("f") else 1.0) for c in CHANNELS[kind]]


class Sample(NamedTuple):
    """One measurement with the state it was taken in.

    `signals`: vx, vy, yaw_rate, steer, drive; `signal_covariance` (3, 3) of the first three;
    `z` as the channels of the measurement kind; `aux` as `single_track.AUXILIARY`; `phi` the parameters of the active
    effects there; `input_variance` (2,) that of steer and drive as they act, which may be later than they are reported.
    """

    signals: Array
    signal_covariance: Array
    z: Array
    aux: Array
    phi: Array | tuple[float, ...] = ()
    input_variance: tuple[float, float] = (0.0, 0.0)


def plausible(sample: Sample) -> bool:
    """Whether its signals and its measurement can be those of a car; what is not a number cannot."""
    return not [value for value in (*sample.signals.tolist(), *sample.z.tolist()) if not abs(value) < PLAUSIBLE]


class TyreBelief:
    """Mean and covariance of theta given the data so far (p(theta_k | z_1..k) of the paper)."""

    def __init__(
        self, model: SingleTrack, settings: BeliefSettings | None = None, effects: Array | None = None
    ) -> None:
        """`effects`: parameters of the model's effects, SI, where the belief is about them too, after the tyres'."""
        self.model, self.settings = model, settings or BeliefSettings()
        self.tyres = len(model.tyre_table)
        self.with_effects = effects is not None
        table = (*model.tyre_table, *(model.effect_table if self.with_effects else ()))
        self.names = tuple(p.name for p in table)
        self.prior = np.array([*(p.prior for p in model.tyre_table), *(() if effects is None else effects)])
        self.scale = np.array([p.prior_std for p in table])
        self._scales = np.outer(self.scale, self.scale)
        self.lower = (np.array([p.lower for p in table]) - self.prior) / self.scale
        self.upper = (np.array([p.upper for p in table]) - self.prior) / self.scale
        self.channel_variance = self.settings.channel_std(model.vehicle.mass) ** 2
        self._longitudinal = np.array([c in ("imu_ax", "fx_r") for c in CHANNELS[self.settings.kind]])
        self._model = model_function(self)
        gate = self.settings.gate_sigma
        self._recursion = recursion_function(len(self.channel_variance), len(self.names), gate).twin()
        self._recursion.arguments[3][:] = self.scale
        self.reset()

    def reset(self) -> None:
        """Back to the prior."""
        self.deviation = np.zeros(len(self.names))
        self.scaled_covariance = np.eye(len(self.names))
        self.samples = 0

    def set_covariance(self, covariance: Array) -> None:
        """Start from a known covariance of theta, SI, instead of the prior's."""
        self.scaled_covariance = covariance / self._scales

    @property
    def mean(self) -> Array:
        """Posterior mean of theta, SI."""
        return np.asarray(self.prior + self.scale * self.deviation)

    @property
    def covariance(self) -> Array:
        """Posterior covariance of theta, SI."""
        return np.asarray(self.scaled_covariance * self._scales)

    @property
    def log_det_information(self) -> float:
        """D-criterion of the posterior precision in prior-scaled units: 0 at the prior, grows with what is learnt."""
        return float(-np.linalg.slogdet(self.scaled_covariance)[1])

    def update(self, sample: Sample, dt: float = 0.01) -> Array:
        """Eq. (8) for one sample; returns the normalised innovation squared of each channel used (may be empty).

        An outlier beyond the gate teaches nothing, nor does a sample that would make anything not finite.
        """
        active = self._active_channels(sample)
        if not active.any():
            return np.empty(0)
        at = self._linearised_at()
        self._predict_sample(sample, at)
        z, acting, teaches, error, linearised, start, spread, covariance = self._recursion.arguments[4:]
        z[:], acting[:], teaches[:], error[:] = sample.z, sample.input_variance, active, self._error_variance()
        linearised[:], start[:] = at, self.deviation
        spread[:], covariance[:] = sample.signal_covariance, self.scaled_covariance
        self._recursion.evaluate()
        deviation, covariance, nis = self._recursion.results
        if finite(deviation, covariance):
            self.deviation, self.scaled_covariance = deviation.copy(), covariance.copy()
            self.samples += 1
            self._keep_sane(dt)
            return np.asarray(nis[active])
        return np.empty(0)

    def _predict_sample(self, sample: Sample, at: Array) -> None:
        """What the model says of a sample at a scaled deviation, to the recursion."""
        signals, aux, theta, phi, _ = self._model.arguments
        signals[:], aux[:], phi[:], theta[:] = sample.signals, sample.aux, sample.phi, self.prior + self.scale * at
        self._model.evaluate()
        for there, here in zip(self._recursion.inputs[:3], self._model.outputs, strict=True):
            there[:] = here

    def _linearised_at(self) -> Array:
        """Scaled deviation at which the Jacobians of the next sample are taken: the present mean."""
        return self.deviation

    def _error_variance(self) -> Array:
        """Variance (m,) of the errors of the next sample, besides that of the motion it was taken in."""
        return self.channel_variance

    def _active_channels(self, sample: Sample) -> npt.NDArray[np.bool_]:
        """Which rows of z may teach: enough speed, and slip (lateral) or drive (longitudinal) to learn from."""
        s = self.settings
        vx, vy, yaw_rate, steer, drive = sample.signals.tolist()
        if not (plausible(sample) and vx > s.min_speed):
            return np.zeros_like(self._longitudinal)
        vehicle = self.model.vehicle
        slip_f = steer - atan2(vy + vehicle.lf * yaw_rate, vx)
        slip_r = -atan2(vy - vehicle.lr * yaw_rate, vx)
        well_known = sqrt(max(float(sample.signal_covariance[1, 1]), 0.0)) < s.max_slip_std * vx
        lateral = well_known and max(abs(slip_f), abs(slip_r)) > s.min_slip
        return np.asarray(np.where(self._longitudinal, abs(drive) > s.min_drive, lateral))

    def _keep_sane(self, dt: float) -> None:
        """Drift and bounds."""
        if self.settings.drift > 0:
            variances = np.einsum("ii->i", self.scaled_covariance)  # a view of the diagonal
            variances += np.minimum(self.settings.drift**2 * dt, np.maximum(1.0 - variances, 0.0))
        if (self.deviation < self.lower).any() or (self.deviation > self.upper).any():
            self._project_on_bounds()

    def _project_on_bounds(self) -> None:
        """Move the mean to the nearest point within the bounds, in the metric of the covariance."""
        for i in np.flatnonzero((self.deviation < self.lower) | (self.deviation > self.upper)):
            excess = self.deviation[i] - np.clip(self.deviation[i], self.lower[i], self.upper[i])
            if (variance := self.scaled_covariance[i, i]) > 0:
                self.deviation = self.deviation - self.scaled_covariance[:, i] / variance * excess
        self.deviation = np.clip(self.deviation, self.lower, self.upper)


def model_function(belief: TyreBelief) -> CompiledFunction:
    """(signals, aux, theta, phi, car) to what is predicted of a sample, and its Jacobians in theta and signals."""
    model, vehicle = of_any_car(belief.model)
    h = measurement_function(model, belief.settings.kind, with_effects=belief.with_effects, vehicle=vehicle)
    return compiled_for(belief.model.vehicle, h)


@cache
def recursion_function(channels: int, parameters: int, gate_sigma: float) -> CompiledFunction:
    """One sample of Eq. (8): (predicted, its Jacobians, scale, z, input variance, active, variance, at, deviation,
    signal covariance, covariance) to new deviation, covariance and normalised innovations squared (m,).

    Deviation (n,) and covariance (n, n) are scaled, `active` (m,) says which channels teach, `variance` (m,) is that of
    their errors. Channels come one after the other, all linearised at the deviation `at`. Of any car and model: made
    once a process, to be used by its `twin`.
    """
    n, m, sym = parameters, channels, ca.MX.sym
    predicted, by_theta, by_signals = sym("predicted", m), sym("by_theta", m, n), sym("by_signals", m, len(SIGNALS))
    z, active, error = (sym(name, m) for name in ("z", "active", "variance"))
    scale, at, start = (sym(name, n) for name in ("scale", "at", "deviation"))
    acting, spread, P = sym("input_variance", 2), sym("spread", 3, 3), sym("P", n, n)
    rows = by_theta * ca.repmat(scale.T, m, 1)
    deviation, covariance, nis = start, P, []
    for i in range(m):
        slip, late = by_signals[i, :3], by_signals[i, 3:] ** 2
        variance = error[i] + slip @ spread @ slip.T + late @ acting
        innovation = z[i] - predicted[i] - rows[i, :] @ (deviation - at)
        S = rows[i, :] @ covariance @ rows[i, :].T + variance
        nis.append(innovation**2 / S)
        teaches = ca.logic_and(active[i], nis[i] <= gate_sigma**2)
        K, after = scalar_update(covariance, rows[i, :], variance)
        deviation = ca.if_else(teaches, deviation + K * innovation, deviation)
        covariance = ca.if_else(teaches, after, covariance)
    inputs = [predicted, by_theta, by_signals, scale, z, acting, active, error, at, start, spread, P]
    results = [deviation, covariance, ca.vertcat(*nis)]
    return compile_function(ca.Function("recursion", inputs, results), flags=EXACT_LOOPS)
