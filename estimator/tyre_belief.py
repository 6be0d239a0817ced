"""Gaussian belief over the tyre parameters, updated sample by sample with Eq. (8).

The recursion runs on parameters scaled by their prior standard deviation, so the prior covariance is the identity.
Sigma_z is diagonal, which makes Eq. (8) equal to one scalar update a channel; each is in Joseph form, so the
covariance stays symmetric positive semi-definite whatever the rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import atan2, sqrt

import numpy as np
import numpy.typing as npt

from estimator.model.compiled import compile_function
from estimator.model.measurement import CHANNELS, MeasurementKind, measurement_function
from estimator.model.single_track import SingleTrack

Array = npt.NDArray[np.float64]

DEFAULT_STD: Mapping[str, float] = {
    "imu_ax": 0.5, "imu_ay": 0.4, "yaw_acc": 0.4, "fx_r": 400.0, "fy_f": 250.0, "fy_r": 250.0,
}  # fmt: skip
"""Measurement standard deviations: sensor noise and what Eq. (1)-(3) leave out, m/s2, rad/s2, N."""

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

    def channel_std(self) -> Array:
        """Standard deviation of each row of z, inflated for serial correlation."""
        table = {**DEFAULT_STD, **(self.std or {})}
        return np.asarray(np.array([table[c] for c in CHANNELS[self.kind]]) * np.sqrt(self.correlation_samples))


@dataclass(frozen=True)
class Sample:
    """One measurement with the state it was taken in.

    `signals`: vx, vy, yaw_rate, steer, drive; `signal_covariance` (3, 3) of the first three;
    `z` as the channels of the measurement kind; `aux` as `single_track.AUXILIARY`; `phi` the parameters of the active
    effects there.
    """

    signals: Array
    signal_covariance: Array
    z: Array
    aux: Array
    phi: Array | tuple[float, ...] = ()


class TyreBelief:
    """Mean and covariance of theta given the data so far (p(theta_k | z_1..k) of the paper)."""

    def __init__(self, model: SingleTrack, settings: BeliefSettings | None = None) -> None:
        self.model, self.settings = model, settings or BeliefSettings()
        table = model.tyre_table
        self.names = tuple(p.name for p in table)
        self.prior = np.array([p.prior for p in table])
        self.scale = np.array([p.prior_std for p in table])
        self.lower = (np.array([p.lower for p in table]) - self.prior) / self.scale
        self.upper = (np.array([p.upper for p in table]) - self.prior) / self.scale
        self._variance = self.settings.channel_std() ** 2
        self._longitudinal = np.array([c in ("imu_ax", "fx_r") for c in CHANNELS[self.settings.kind]])
        self._h = MeasurementEvaluation(model, self.settings.kind)
        self._eye = np.eye(len(table))
        self.resets = 0
        self.reset()

    def reset(self) -> None:
        """Back to the prior."""
        self.deviation = np.zeros(len(self.names))
        self.scaled_covariance = np.eye(len(self.names))
        self.samples = 0
        self.innovations_rejected = 0

    def set_covariance(self, covariance: Array) -> None:
        """Start from a known covariance of theta, SI, instead of the prior's."""
        self.scaled_covariance = covariance / np.outer(self.scale, self.scale)

    @property
    def mean(self) -> Array:
        """Posterior mean of theta, SI."""
        return np.asarray(self.prior + self.scale * self.deviation)

    @property
    def covariance(self) -> Array:
        """Posterior covariance of theta, SI."""
        return np.asarray(self.scaled_covariance * np.outer(self.scale, self.scale))

    @property
    def log_det_information(self) -> float:
        """D-criterion of the posterior precision in prior-scaled units: 0 at the prior, grows with what is learnt."""
        return float(-np.linalg.slogdet(self.scaled_covariance)[1])

    def update(self, sample: Sample, dt: float = 0.01) -> Array:
        """Eq. (8) for one sample; returns the normalised innovation squared of each channel used (may be empty)."""
        active = self._active_channels(sample)
        if not active.any():
            return np.empty(0)
        h, h_theta, h_signals = self._h(sample.signals, sample.aux, self.mean, sample.phi)
        if not (np.isfinite(h).all() and np.isfinite(h_theta).all() and np.isfinite(h_signals).all()):
            return np.empty(0)
        slip_noise = np.einsum("ij,jk,ik->i", h_signals[:, :3], sample.signal_covariance, h_signals[:, :3])
        variance = self._variance + slip_noise
        start = self.deviation.copy()
        rows = h_theta * self.scale
        nis = [
            self._update_channel(sample.z[i] - h[i] - rows[i] @ (self.deviation - start), rows[i], variance[i])
            for i in np.flatnonzero(active)
        ]
        self.samples += 1
        self._keep_sane(dt)
        return np.array(nis)

    def _update_channel(self, innovation: float, H: Array, variance: float) -> float:
        """Scalar Eq. (8), Joseph form; an outlier beyond the gate is counted and left out."""
        PH = self.scaled_covariance @ H
        S = float(H @ PH) + variance
        nis = innovation * innovation / S
        if nis > self.settings.gate_sigma**2:
            self.innovations_rejected += 1
            return nis
        K = PH / S
        column = K[:, None]
        A = self._eye - column * H
        P = A @ self.scaled_covariance @ A.T + variance * column * K
        self.scaled_covariance = 0.5 * (P + P.T)
        self.deviation = self.deviation + K * innovation
        return nis

    def _active_channels(self, sample: Sample) -> npt.NDArray[np.bool_]:
        """Which rows of z may teach: enough speed, and slip (lateral) or drive (longitudinal) to learn from."""
        s, signals = self.settings, sample.signals.tolist()
        vx, vy, yaw_rate, steer, drive = signals
        plausible = all(abs(value) < PLAUSIBLE for value in (*signals, *sample.z.tolist()))  # NaN is not
        if not (plausible and vx > s.min_speed):
            return np.zeros(len(self._variance), dtype=bool)
        vehicle = self.model.vehicle
        slip_f = steer - atan2(vy + vehicle.lf * yaw_rate, vx)
        slip_r = -atan2(vy - vehicle.lr * yaw_rate, vx)
        well_known = sqrt(max(float(sample.signal_covariance[1, 1]), 0.0)) < s.max_slip_std * vx
        lateral = well_known and max(abs(slip_f), abs(slip_r)) > s.min_slip
        return np.asarray(np.where(self._longitudinal, abs(drive) > s.min_drive, lateral))

    def _keep_sane(self, dt: float) -> None:
        """Drift, bounds, and a reset should anything have become non-finite."""
        if self.settings.drift > 0:
            room = np.clip(1.0 - np.diag(self.scaled_covariance), 0.0, None)
            self.scaled_covariance += np.diag(np.minimum(self.settings.drift**2 * dt, room))
        if not (np.isfinite(self.deviation).all() and np.isfinite(self.scaled_covariance).all()):
            self.resets += 1
            self.reset()
        self._project_on_bounds()

    def _project_on_bounds(self) -> None:
        """Move the mean to the nearest point within the bounds, in the metric of the covariance."""
        for i in np.flatnonzero((self.deviation < self.lower) | (self.deviation > self.upper)):
            excess = self.deviation[i] - np.clip(self.deviation[i], self.lower[i], self.upper[i])
            if (variance := self.scaled_covariance[i, i]) > 0:
                self.deviation = self.deviation - self.scaled_covariance[:, i] / variance * excess
        self.deviation = np.clip(self.deviation, self.lower, self.upper)


class MeasurementEvaluation:
    """h and its Jacobians for one model.

    Interpreted, not compiled: a dozen microseconds a call, and the same bits on every computer.
    """

    def __init__(self, model: SingleTrack, kind: MeasurementKind) -> None:
        self._function = compile_function(measurement_function(model, kind), compiled=False)

    def __call__(
        self, signals: Array, aux: Array, theta: Array, phi: Array | tuple[float, ...] = ()
    ) -> tuple[Array, Array, Array]:
        """h (m,), dh/dtheta (m, n), dh/dsignals (m, 5); copies, safe to keep."""
        for array, values in zip(self._function.inputs, (signals, aux, theta, phi), strict=True):
            array.ravel(order="F")[:] = values
        self._function()
        h, h_theta, h_signals = self._function.outputs
        return h[:, 0].copy(), h_theta.copy(), h_signals.copy()
