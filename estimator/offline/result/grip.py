"""Grip of another log: the same tyres on another floor give another force at the same slip.

The factor on D of both axles with which ay at the measured states is predicted best where the tyres slip about as much
as those learnt from. There the force hardly depends on the slip, nor on its noise; in gentle driving noise would make
every tyre look softer, and no grip shows. The cornering stiffness changes with the factor or not, as fits better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.model.columns import ModelColumns
from estimator.offline.fit.problem import huber_loss
from estimator.offline.health.regression import PARTS
from estimator.offline.record.prepare import Samples, slip_angles
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

FACTORS = np.geomspace(0.4, 2.5, 21)
HUBER = 2.0
"""Standard deviations from which on an error counts linearly."""
SLIDING = 0.5
"""Share of the slip reached in the log learnt from (99th percentile) from which on a sample tells of the grip."""
LEAST_S = 5.0
"""so long at least must the tyres slip so much"""
LEAST = 0.05
"""Relative difference of the force that counts: temperature and dust change it by as much from hour to hour."""
ERRORS = 3.0
"""Standard errors beyond which it is no scatter."""


@dataclass(frozen=True)
class Grip:
    """Largest lateral force of a log over that of the log learnt from, `factor` +- `std`; nan where it cannot tell."""

    factor: float
    std: float

    def over(self, other: Grip) -> Grip:
        """This grip over another one; what the model is off by in both cancels."""
        factor = self.factor / other.factor
        return Grip(factor, factor * float(np.hypot(self.std / self.factor, other.std / other.factor)))

    @property
    def differs(self) -> bool:
        """Whether it is another floor, or other tyres, beyond the error and what changes from hour to hour."""
        return abs(self.factor - 1.0) > max(LEAST, ERRORS * self.std)

    @property
    def words(self) -> str:
        """The factor with its 95 % interval, and what follows from it."""
        if not np.isfinite(self.factor):
            return "whether the floor differs cannot be told: the tyres slip too little; drive closer to the limit"
        low, high = self.factor - 1.96 * self.std, self.factor + 1.96 * self.std
        text = f"grip {self.factor:.2f} (95 %: {low:.2f} to {high:.2f}) of that of the log learnt from"
        if self.differs:
            return f"another floor or other tyres: {text}; identify on a log of this floor"
        return f"the same floor as far as the log tells: {text}"

    def summary(self) -> dict[str, float | bool | str | None]:
        """As it appears in JSON; null where the log cannot tell."""
        known = np.isfinite(self.factor)
        numbers = {"factor": self.factor, "std": self.std, "differs": self.differs}
        return {**(numbers if known else dict.fromkeys(numbers)), "description": self.words}


UNKNOWN = Grip(float("nan"), float("nan"))


def slides(samples: Samples, vehicle: Vehicle, reached: tuple[float, float]) -> NDArray[np.bool_]:
    """(n,) samples at which an axle slips nearly as much as was `reached` (rad; front, rear) where it was learnt."""
    each = zip(slip_angles(samples, vehicle), reached, strict=True)
    return np.asarray(np.any([np.abs(slip) > SLIDING * most for slip, most in each], axis=0))


def grip_of(columns: ModelColumns, samples: Samples, theta: Array) -> Grip:
    """Grip of `samples` over that for which `theta` (p,) was learnt; its error by parts left out in turn."""
    if len(samples) * samples.step < LEAST_S:
        return UNKNOWN
    each = [_losses(columns, samples, theta, kept) for kept in (False, True)]
    losses = min(each, key=lambda one: float(one.sum(axis=0).min()))
    left_out = np.array([_lowest(losses.sum(axis=0) - part) for part in losses])
    std = float(np.sqrt((PARTS - 1) / PARTS * np.sum((left_out - left_out.mean()) ** 2)))
    factor = float(np.exp(_lowest(losses.sum(axis=0))))
    return Grip(factor, factor * std)


def _losses(columns: ModelColumns, samples: Samples, theta: Array, stiffness_kept: bool) -> Array:
    """(PARTS, factors) of parts of the samples for every factor, over the spread at `theta`."""
    tried = [_scaled(columns, theta, f, stiffness_kept) for f in FACTORS]
    errors = samples["ay"] - np.stack([columns.predict(samples.inputs, one, ("ay",))[0] for one in tried])
    spread = 1.4826 * float(np.median(np.abs(samples["ay"] - columns.predict(samples.inputs, theta, ("ay",))[0])))
    losses = huber_loss(errors / max(spread, 1e-9), HUBER)
    return np.stack([part.sum(axis=1) for part in np.array_split(losses, PARTS, axis=1)])


def _scaled(columns: ModelColumns, theta: Array, factor: float, stiffness_kept: bool) -> Array:
    """`theta` with the peak D of every axle times `factor`, and with B C D as it was or not."""
    power = {"d": 1.0, "b": -1.0 * stiffness_kept}
    powers = [0.0 if "." in p.name else power.get(p.name[0], 0.0) for p in columns.parameters]
    return np.asarray(theta * factor ** np.array(powers))


def _lowest(loss: Array) -> float:
    """Logarithm of the factor at the minimum of `loss` over `FACTORS`, by a parabola."""
    at = int(np.clip(np.argmin(loss), 1, len(loss) - 2))
    left, middle, right = loss[at - 1 : at + 2]
    shift = 0.5 * (left - right) / max(left - 2.0 * middle + right, 1e-300)
    return float(np.log(FACTORS[at]) + np.clip(shift, -1.0, 1.0) * np.log(FACTORS[1] / FACTORS[0]))
