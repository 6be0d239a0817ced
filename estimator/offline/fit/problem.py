"""What a fit minimises: robust residuals over their spreads, with a prior, in scaled parameters.

Parameters are scaled by their prior standard deviation. The loss is Huber's on residuals over the robust spread of
each channel. Source: Huber, Robust Statistics.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.model.columns import CHANNELS, ModelColumns
from estimator.model.parameters import Parameter
from estimator.offline.fit.coordinates import StepCoordinates
from estimator.offline.record.prepare import Samples, slip_angles
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

LATERAL_AND_LONGITUDINAL = ("ax", "ay", "yaw_acc")
"""Channels that determine the tyre parameters; the motion channels add what gravity does."""

BLOCKS_WANTED = 5.0
"""Time blocks per parameter from which their scatter is known well enough; blocks are shortened to have so many."""

SHORTEST_BLOCK = 1.82
"""No block is shorter over the car's own time, 1 s for an AV-24: what a model lacks lasts as long as a manoeuvre."""


SLIP_QUANTILES = (0.5, 0.9, 0.995)
LEAST_SLIPS = (1e-4, 2e-4, 3e-4)
"""rad"""


@dataclass(frozen=True)
class FitSettings:
    """How a fit is done.

    `huber`: residuals beyond so many robust spreads count linearly. `block_s`: residuals further apart are taken
    as independent; less on short logs, see `block_length`. `prior`: whether the prior takes part.
    `tolerance`: a fit has converged when the next step is shorter than so many standard deviations.
    """

    channels: tuple[str, ...] = LATERAL_AND_LONGITUDINAL
    huber: float = 3.0
    block_s: float = 4.0
    prior: bool = True
    max_iterations: int = 40
    tolerance: float = 0.01


class FitProblem(ABC):
    """One fit in scaled parameters u = (theta - prior) / prior_std; `spread` (c,) weighs the channels."""

    def __init__(self, table: Sequence[Parameter], settings: FitSettings, slips: Mapping[str, Array]) -> None:
        """Scale, bounds and prior of `table`; `slips` as for `StepCoordinates`."""
        self.coordinates = StepCoordinates(table, slips)
        self.table, self.settings, self.size = tuple(table), settings, len(table)
        self.prior = np.array([p.prior for p in table])
        self.scale = np.array([p.prior_std for p in table])
        self.lower = self.scaled(np.array([p.lower for p in table]))
        self.upper = self.scaled(np.array([p.upper for p in table]))
        self.precision = np.eye(self.size) if settings.prior else np.zeros((self.size, self.size))
        self.spread = np.ones(len(self.channels))

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Names of the residual channels."""

    @abstractmethod
    def residual_rms(self, u: Array) -> Array:
        """(c,) root mean square residual."""

    @abstractmethod
    def robust_spread(self, u: Array) -> Array:
        """(c,) robust standard deviation of the residuals."""

    def first_spread(self, u: Array) -> Array:
        """(c,) spread to begin with, where the residuals are those of a start far from the answer."""
        return self.robust_spread(u)

    @abstractmethod
    def cost(self, u: Array) -> float:
        """Robust loss plus the prior's."""

    @abstractmethod
    def normal_equations(self, u: Array) -> tuple[Array, Array]:
        """Gauss-Newton Hessian (p, p) and gradient (p,) of the cost, prior included."""

    @abstractmethod
    def information_and_scatter(self, u: Array) -> tuple[Array, Array, int]:
        """Data information (p, p), outer products of the scores of time blocks (p, p) summed, number of blocks."""

    def scaled(self, theta: Array) -> Array:
        return np.asarray((theta - self.prior) / self.scale, float)

    def theta(self, u: Array) -> Array:
        return np.asarray(self.prior + self.scale * u)

    def prior_cost(self, u: Array) -> float:
        """Half the squared distance to the prior mean."""
        return 0.5 * float(u @ self.precision @ u)


class AlgebraicProblem(FitProblem):
    """Forces from measured states against specific forces and yaw acceleration: the paper's formulation."""

    def __init__(self, columns: ModelColumns, samples: Samples, settings: FitSettings) -> None:
        """`settings.channels` of `samples` against `columns`."""
        super().__init__(columns.parameters, settings, typical_slips(samples, columns.model.vehicle))
        self.columns, self.samples = columns, samples
        index = [CHANNELS.index(c) for c in settings.channels]
        self.measured = samples.channels[index]
        self.noise = samples.noise[index]

    @property
    def channels(self) -> tuple[str, ...]:
        return self.settings.channels

    def residuals(self, u: Array) -> Array:
        predicted = self.columns.predict(self.samples.inputs, self.theta(u), self.settings.channels)
        return np.asarray(self.measured - predicted)

    def robust_spread(self, u: Array) -> Array:
        errors = np.abs(self.residuals(u))
        # never below half the noise floor nor near zero: a perfect fit would otherwise weigh infinitely
        least = 1e-6 * np.sqrt(np.mean(self.measured**2, axis=1)) + 1e-12
        typical = 1.4826 * np.median(errors, axis=1)
        return np.asarray(np.maximum(np.maximum(typical, 0.5 * self.noise), least), float)

    def first_spread(self, u: Array) -> Array:
        """Yaw acceleration no better known than an axle's force is from ay.

        In a light car with short axles the moment is a small difference of large forces: weighed by its residuals at
        the prior it would be explained best by tyres without force.
        """
        spread = dict(zip(self.channels, self.robust_spread(u).tolist(), strict=True))
        if {"ay", "yaw_acc"} <= spread.keys():
            car = self.columns.model.vehicle
            by_axle = 0.5 * car.wheelbase * car.mass / car.yaw_inertia
            spread["yaw_acc"] = max(spread["yaw_acc"], by_axle * spread["ay"])
        return np.array(list(spread.values()))

    def cost(self, u: Array) -> float:
        z = self.residuals(u) / self.spread[:, None]
        return float(np.sum(huber_loss(z, self.settings.huber))) + self.prior_cost(u)

    def residual_rms(self, u: Array) -> Array:
        return np.asarray(np.sqrt(np.mean(self.residuals(u) ** 2, axis=1)))

    def normal_equations(self, u: Array) -> tuple[Array, Array]:
        H, g = self.precision.copy(), self.precision @ u
        for _, errors, J in self._linearised(u):
            weighted = J * huber_weight(errors, self.settings.huber)[:, None, :]
            H += np.einsum("cpn,cqn->pq", weighted, J, optimize=True)
            g -= np.einsum("cpn,cn->p", weighted, errors)
        return H, g

    def information_and_scatter(self, u: Array) -> tuple[Array, Array, int]:
        duration_s = len(self.samples) * self.samples.step
        block = time_blocks(self.samples, block_length(self, duration_s, self.columns.model.vehicle.own_time))
        scores = np.zeros((self.size, int(block[-1]) + 1))
        H = np.zeros((self.size, self.size))
        for rows, errors, J in self._linearised(u):
            H += np.einsum("cpn,cqn->pq", J * (np.abs(errors) < self.settings.huber)[:, None, :], J, optimize=True)
            score = np.einsum("cpn,cn->pn", J, huber_weight(errors, self.settings.huber) * errors)
            for i in range(self.size):
                scores[i] += np.bincount(block[rows], score[i], scores.shape[1])
        return H, scores @ scores.T, scores.shape[1]

    def _linearised(self, u: Array) -> Iterator[tuple[slice, Array, Array]]:
        for rows, predicted, J in self.columns.linearise(self.samples.inputs, self.theta(u), self.settings.channels):
            errors = (self.measured[:, rows] - predicted) / self.spread[:, None]
            yield rows, errors, J * (self.scale[:, None] / self.spread[:, None, None])


def typical_slips(samples: Samples, vehicle: Vehicle) -> dict[str, Array]:
    """Three slip angles, rad, that span what the data hold, of both axles together, the front and the rear one."""
    front, rear = (np.abs(slip) for slip in slip_angles(samples, vehicle))
    each = {"": np.concatenate([front, rear]), "f": front, "r": rear}
    return {suffix: np.maximum(np.quantile(slip, SLIP_QUANTILES), LEAST_SLIPS) for suffix, slip in each.items()}


def huber_weight(z: Array, limit: float) -> Array:
    """Weight that makes squared residuals act like Huber's loss."""
    return np.asarray(np.minimum(1.0, limit / np.maximum(np.abs(z), 1e-12)))


def huber_loss(z: Array, limit: float) -> Array:
    """z^2 / 2 up to `limit`, linear beyond."""
    size = np.abs(z)
    return np.where(size <= limit, 0.5 * size * size, limit * (size - 0.5 * limit))


def block_length(problem: FitProblem, duration_s: float, own_time: float) -> float:
    """Length of the time blocks whose scores are taken as independent, s, as is the `own_time` of the car."""
    wanted = duration_s / (BLOCKS_WANTED * problem.size)
    return min(problem.settings.block_s, max(wanted, SHORTEST_BLOCK * own_time))


def time_blocks(samples: Samples, length_s: float) -> NDArray[np.int64]:
    """(n,) number of the time block of each sample; a gap starts a new one."""
    number = np.floor((samples.t - samples.t[0]) / length_s)
    change = np.concatenate([[False], (np.diff(number) != 0) | (np.diff(samples.segment) != 0)])
    return np.cumsum(change).astype(np.int64)
