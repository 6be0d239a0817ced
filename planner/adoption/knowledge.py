"""What the planner knows of the tyres: parameters in force, the belief about them, and what of it may be asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.belief.revision import RevisedModel, tyre_covariance
from estimator.model.parameters import Quantity
from estimator.model.tyre import front_and_rear
from hil_gateway.bus.messages import Belief, ModelRevision
from hil_gateway.process.arrays import Array
from planner.adoption.brake_doubt import brake_doubt
from planner.adoption.delivered import DeliveredShares, grip_factors
from planner.adoption.unlearnt import oversteering
from planner.adoption.usable_grip import Axles, capacity, rear_share
from planner.plan.controller import TyreKnowledge
from planner.problem.brake_law import pressure_ratio
from planner.problem.load_limits import SLEW, judged_limits

FIRST_LAP = 1.25
"""times the standard deviations of Eq. (10) in a first lap, and in every lap where nothing corrects the model: what is
believed then comes from a data sheet and from forces far below the peak, and is wrong by two standard deviations more
often than it says. Where no data sheet is believed (`declared_model` paper) the prior is as wide as that says"""


@dataclass(frozen=True)
class TyreNames:
    """Order and prior spread of a model's tyre parameters, and where those of each axle are."""

    names: tuple[str, ...]
    prior_std: Array
    axles: Axles

    @classmethod
    def of(cls, revised: RevisedModel) -> TyreNames:
        """Of a revised model."""
        table = revised.model.tyre_table
        names = tuple(p.name for p in table)
        front, rear = front_and_rear(revised.model.layout)
        return cls(names, np.array([p.prior_std for p in table]), (front.rows(names), rear.rows(names)))


@dataclass(frozen=True)
class Reserves:
    """What is kept back of the tyres: `use` of their peak at most, with `level` standard deviations of the belief.

    `by_data_sheet`: the belief began with what is declared of this car, and tells the balance of its axles.
    """

    use: float
    level: float
    by_data_sheet: bool
    front_response: float | None = None
    """where nothing corrects the model: share of what it says that front tyres respond with, inf where not known"""

    @classmethod
    def of(
        cls, use: float, level: float, by_data_sheet: bool, lap: int, front_response: float | None = None
    ) -> Reserves:
        """In this lap, the first being 0."""
        level *= FIRST_LAP if by_data_sheet and lap < 1 else 1.0
        return cls(use, level, by_data_sheet, front_response)

    def uses(self, peaks: Array) -> Array:
        """(2,) share of its peak that either axle may use, from the `peaks` over axle load."""
        return self.use * np.array([1.0, rear_share(peaks) if self.by_data_sheet else 1.0])


@dataclass(frozen=True)
class GripState:
    """What tyres and brakes deliver, the forces over axle load (front, rear) that were held, and what is kept back."""

    delivered: DeliveredShares
    sustained: tuple[float, float]
    reserves: Reserves
    brake_spread: tuple[float, float]
    """of the revision, see there"""


def next_knowledge(  # noqa: PLR0917 - all that a plan's tyres depend on
    before: TyreKnowledge | None, revised: RevisedModel, tyre: TyreNames, revision: ModelRevision,
    belief: Belief | None, state: GripState,
) -> TyreKnowledge:  # fmt: skip
    """Tyre parameters one slew step from those `before` towards the revision, with what is believed of them."""
    lasting = _one_step(before, target_of(revised, revision, tyre, state.reserves), tyre)
    mean, covariance = _believed(
        belief, revision, tyre, lasting if state.reserves.front_response is None else revised.theta
    )
    peaks, level = [d for _, _, d in tyre.axles], state.reserves.level
    use = state.reserves.uses(mean[peaks])
    # by the tyres as they last: a plan that gets by with what a sudden loss leaves may ask for all of it
    judged = judged_limits(state.reserves.use, lasting[peaks], before.load_max if before else None)
    factors = grip_factors(tyre.axles, state.delivered.tyres, len(lasting))
    theta, mean, covariance = factors * lasting, factors * mean, covariance * np.outer(factors, factors)
    # a belief that has learnt of less grip tells at once, before the model in force follows
    asked = capacity(tyre.axles, np.minimum(mean, theta), covariance, use=use, level=level, sustained=state.sustained)
    doubt = brake_doubt(state.brake_spread, np.sqrt(np.diag(covariance)[peaks]) / mean[peaks], level)
    front, rear = (d / rolling for d, rolling in zip(doubt, state.delivered.rolling, strict=True))
    return TyreKnowledge(
        theta, mean, covariance, tyre.prior_std, judged, (float(use[0]), float(use[1])), asked,
        _brake_ratio(before, asked, revised), level, (front, rear), state.delivered.tyres,
    )  # fmt: skip


def at_rest(
    knowledge: TyreKnowledge, revised: RevisedModel, tyre: TyreNames, revision: ModelRevision, reserves: Reserves
) -> bool:
    """Whether a further step with the same belief, revision and delivered shares changes nothing."""
    lasting = _one_step(knowledge, target_of(revised, revision, tyre, reserves), tyre)
    theta = grip_factors(tyre.axles, knowledge.delivered, len(lasting)) * lasting
    peaks = lasting[[d for _, _, d in tyre.axles]]
    return (
        np.array_equal(theta, knowledge.theta)
        and judged_limits(reserves.use, peaks, knowledge.load_max) == knowledge.load_max
        and _brake_ratio(knowledge, knowledge.capacity, revised) == knowledge.brake_ratio
    )


def target_of(revised: RevisedModel, revision: ModelRevision, tyre: TyreNames, reserves: Reserves) -> Array:
    """theta that parameters in force go to."""
    response = reserves.front_response
    if response is None or (stated := tyre_covariance(revision)) is None:
        return revised.theta
    return oversteering(revised.theta, stated, tyre.axles, response)


def _one_step(before: TyreKnowledge | None, target: Array, tyre: TyreNames) -> Array:
    """theta of tyres that deliver all they have, towards `target` by `SLEW`."""
    if before is None or len(before.theta) != len(target):
        return target
    lasting = before.theta / grip_factors(tyre.axles, before.delivered, len(target))
    return np.asarray(np.clip(target, lasting * (1 - SLEW), lasting * (1 + SLEW)))


def _believed(belief: Belief | None, revision: ModelRevision, tyre: TyreNames, theta: Array) -> tuple[Array, Array]:
    """Mean and covariance of the tyre parameters: the newest belief, else the revision's, else the prior's."""
    if belief is not None and belief.names == tyre.names:
        return np.array(belief.mean), np.array(belief.covariance)
    stated = tyre_covariance(revision)
    return theta, np.diag(tyre.prior_std**2) if stated is None else stated


def _brake_ratio(before: TyreKnowledge | None, asked: tuple[float, float], revised: RevisedModel) -> float:
    """Front over rear brake pressure for what is asked of the axles, one slew step from that before."""
    ratio = pressure_ratio(asked, revised.constant(Quantity.FRONT_BRAKE_SHARE))
    if before is None:
        return ratio
    return float(np.clip(ratio, before.brake_ratio * (1 - SLEW), before.brake_ratio * (1 + SLEW)))
