"""The model the estimator works with: belief, revision policy and monitor that belong to one list of effects.

Another list needs all of them anew (some tenths of a second). They are built beside the running filter, and begin with
the covariance that comes with the model: what the laps so far have taught, of tyres and effects.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass

import numpy as np

from estimator.belief.delivery import Delivery
from estimator.belief.relinearised import RelinearisedBelief
from estimator.belief.residual_monitor import ResidualMonitor
from estimator.belief.revision import RevisedModel, RevisionPolicy, learns_effects, model_of, unusable
from estimator.belief.tyre_belief import BeliefSettings, TyreBelief
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.bus.proposal import ModelProposal
from hil_gateway.config import Config
from hil_gateway.process.lifecycle import worth_a_line

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelInUse:
    """One model with what learns it and what watches it."""

    revised: RevisedModel
    belief: TyreBelief
    policy: RevisionPolicy
    monitor: ResidualMonitor
    delivery: Delivery

    @classmethod
    def of(cls, config: Config, revision: ModelRevision, lap_length: float) -> ModelInUse:
        """Of a revision, from which learning goes on; `lap_length` m."""
        revised = model_of(revision, config.vehicle, lap_length)
        belief_class = RelinearisedBelief if config.estimator.relinearise else TyreBelief
        effects = revised.constants if learns_effects(revision) else None
        belief = belief_class(revised.model, BeliefSettings(kind=config.estimator.measurement), effects)
        if revision.covariance:
            belief.set_covariance(np.array(revision.covariance))
        policy, model = RevisionPolicy(config.estimator, revision), revised.model
        return cls(revised, belief, policy, ResidualMonitor(model), Delivery(model))


class Succession:
    """The model that is to follow the one in use; `background`: it is built in a thread."""

    def __init__(self, config: Config, lap_length: float, *, background: bool) -> None:
        self._config, self._lap_length, self._background = config, lap_length, background
        self._next: ModelInUse | None = None
        self._use_from_ns = self._refused = 0
        self._worker: threading.Thread | None = None

    def offer(self, proposal: ModelProposal, current: ModelRevision) -> None:
        """Build the model of a proposal, if it has one that can be used and nothing else is being built."""
        revision = proposal.revision
        if revision is None or self._worker is not None or self._next is not None:
            return
        if reason := unusable(revision, current):
            self._refused += 1
            if worth_a_line(self._refused):
                log.warning("proposed model no. %d not used, %s: %s", self._refused, revision.revision, reason)
            return
        self._use_from_ns = proposal.use_from_ns
        if self._background:
            self._worker = threading.Thread(target=self._build, args=(revision,), name="next model", daemon=True)
            self._worker.start()
        else:
            self._build(revision)

    def take(self, stamp_ns: int) -> ModelInUse | None:
        """The model to use from the vehicle state with this stamp on, once."""
        if self._next is None or stamp_ns < self._use_from_ns:
            return None
        made, self._next = self._next, None
        return made

    def _build(self, revision: ModelRevision) -> None:
        try:
            self._next = ModelInUse.of(self._config, revision, self._lap_length)
        finally:
            self._worker = None
