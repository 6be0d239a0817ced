"""Which model the planner drives with: model revisions taken over without missing a plan, and given back if bad.

New parameter values are written into the running controller and approached slowly. Another list of active effects
needs new compiled functions: they are built beside the running planner and swapped in between two plans. A revision
that makes plans fail soon after is rolled back and not tried again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimator.model.effects import catalogue
from estimator.revision import RevisedModel, model_of
from hil_gateway.config import Config
from hil_gateway.messages import Belief, ModelRevision
from hil_gateway.track import Track
from planner.controller import Controller, TyreKnowledge
from planner.envelope import envelope_of
from planner.functions import Functions, build_functions, build_in_child
from planner.load_limits import LoadLimits
from planner.mpcc import Problem
from planner.raceline import RaceLine, raceline_for
from planner.settings import Settings
from planner.track import Reference

Array = npt.NDArray[np.float64]

SLEW = 0.01
"""largest relative change of a tyre parameter from one plan to the next"""
PROFILE_SHARE = 0.9
"""of the load limits that the race line's speed profile asks for; the rest corrects errors"""
PROFILE_CHANGE = 0.02
"""relative change of usable grip that is worth a new speed profile"""
PROBATION = 40
"""plans after an adoption during which failures count against the new revision"""
PROBATION_FAILURES = 3
RACE_LINE_MARGIN = 1.6
"""least distance of the race line from the edges, m"""


@dataclass
class Adopted:
    """A controller with the revision it was built for."""

    revision: ModelRevision
    revised: RevisedModel
    controller: Controller


class Adoption:
    """The model in force; `offer` revisions and beliefs, call `advance` before every plan."""

    def __init__(
        self, config: Config, track: Track, settings: Settings, limits: LoadLimits, revision: ModelRevision,
        *, background: bool = False,
    ) -> None:  # fmt: skip
        self._config, self._track, self._settings, self._limits = config, track, settings, limits
        self._background = background
        self._belief: Belief | None = None
        self._refused: set[str] = set()
        self._previous: Adopted | None = None
        self._ready: Adopted | None = None
        self._worker: threading.Thread | None = None
        self._probation = self._failures = 0
        self.notes: list[str] = []
        """what was refused or rolled back, and why; newest last"""
        self._line: RaceLine | None = None
        self._grip = 0.0
        self.current = self._adopt(revision, build_functions)

    @property
    def controller(self) -> Controller:
        """The controller to plan with."""
        return self.current.controller

    def offer(self, revision: ModelRevision) -> None:
        """Consider a revision from the estimator."""
        if revision.revision in self._refused or revision.revision == self.current.revision.revision:
            return
        if reason := implausible(revision, self.current.revision.layout):
            self._refuse(revision, reason)
        elif [e.name for e in revision.effects] == [e.name for e in self.current.revision.effects]:
            revised = model_of(revision, self._config.vehicle, self._track.length)
            self.current.revision, self.current.revised = revision, revised
            self.controller.phi_at = revised.phi_at
        elif self._worker is None:
            self._build(revision)

    def offer_belief(self, belief: Belief) -> None:
        """Use a belief for Eq. (7) and (10), if it fits the model."""
        names = tuple(p.name for p in self.current.revised.model.tyre_table)
        if belief.names == names:
            self._belief = belief

    def advance(self) -> bool:
        """Move parameters towards the revision in force and swap in a finished build; True if the path changed."""
        swapped = self._ready is not None
        if self._ready is not None:
            self._swap(self._ready)
        self.controller.set_knowledge(self._knowledge(self.controller.knowledge.theta))
        return self._refresh_profile() or swapped

    def judge(self, accepted: bool) -> None:
        """Outcome of a plan with the model in force; rolls a new model back that keeps failing."""
        if self._probation == 0:
            return
        self._probation -= 1
        self._failures += not accepted
        if self._failures >= PROBATION_FAILURES and self._previous is not None:
            self._refuse(self.current.revision, "plans with it failed, rolled back")
            self.current, self._previous, self._probation = self._previous, None, 0

    def _refuse(self, revision: ModelRevision, reason: str) -> None:
        self._refused.add(revision.revision)
        self.notes = [*self.notes[-99:], f"revision {revision.revision}: {reason}"]

    def _build(self, revision: ModelRevision) -> None:
        if not self._background:
            self._ready = self._adopt(revision, build_functions)
            return

        def work() -> None:
            try:
                self._ready = self._adopt(revision, build_in_child)
            except RuntimeError as error:
                self._refuse(revision, str(error))
            finally:
                self._worker = None

        self._worker = threading.Thread(target=work, name="model build", daemon=True)
        self._worker.start()

    def _adopt(self, revision: ModelRevision, build: Callable[[Problem], Functions]) -> Adopted:
        revised = model_of(revision, self._config.vehicle, self._track.length)
        problem = Problem(revised.model, self._settings)
        functions = build(problem)
        knowledge = self._knowledge(None, revised, revision)
        reference = self._reference(revised, knowledge)
        backend = self._config.planner.backend
        controller = Controller(problem, functions, reference, knowledge, phi_at=revised.phi_at, backend=backend)
        return Adopted(revision, revised, controller)

    def _swap(self, new: Adopted) -> None:
        """Carry the guess over: the new model starts from the plan of the old one."""
        old = self.controller.sqp
        new.controller.sqp.set_guess(old.z.copy(), old.du.copy())
        self._previous, self.current, self._ready = self.current, new, None
        self._probation, self._failures = PROBATION, 0

    def _knowledge(
        self, theta: Array | None, revised: RevisedModel | None = None, revision: ModelRevision | None = None
    ) -> TyreKnowledge:
        """Tyre parameters one slew step from `theta` towards the revision, with the newest belief."""
        revised, revision = revised or self.current.revised, revision or self.current.revision
        target = revised.theta
        if theta is not None and len(theta) == len(target):
            target = np.clip(target, theta * (1 - SLEW), theta * (1 + SLEW))
        prior_std = np.array([p.prior_std for p in revised.model.tyre_table])
        belief = self._belief
        if belief is not None and len(belief.mean) == len(target):
            mean, covariance = np.array(belief.mean), np.array(belief.covariance)
        elif revision.covariance:
            mean, covariance = target, np.array(revision.covariance)
        else:
            mean, covariance = target, np.diag(prior_std**2)
        # within a run the limits may only shrink: the model in force has less grip than they were set for
        use = self._config.planner.load_use
        front, rear = (min(a, use * b) for a, b in zip(self._limits.pair, _peaks(revised, target), strict=True))
        return TyreKnowledge(target, mean, covariance, prior_std, (front, rear))

    def _reference(self, revised: RevisedModel, knowledge: TyreKnowledge) -> Reference:
        """Race line of a model, or the line in use with the speed profile of this model."""
        grip = usable_grip(revised, knowledge)
        at_start = revised.phi_at(np.zeros(1))[:, 0]
        maximum = self._settings.limits.speed - 2.0
        envelope = envelope_of(revised.model, list(knowledge.theta), list(at_start), grip_use=grip, max_speed=maximum)
        if self._line is None:
            self._line = raceline_for(self._track, envelope, RACE_LINE_MARGIN)
        self._line = self._line.with_envelope(envelope)
        self._grip = grip * float(np.mean(_peaks(revised, knowledge.theta)))
        return Reference(self._line)

    def _refresh_profile(self) -> bool:
        """New speed profile on the same path when the usable grip has changed."""
        knowledge, revised = self.controller.knowledge, self.current.revised
        grip = usable_grip(revised, knowledge) * float(np.mean(_peaks(revised, knowledge.theta)))
        if abs(grip / self._grip - 1.0) > PROFILE_CHANGE:
            self.controller.reference = self._reference(revised, knowledge)
        return False


def implausible(revision: ModelRevision, layout: str) -> str:
    """Why a revision must not be driven with; empty when it may."""
    if revision.layout != layout:
        return f"layout {revision.layout} is not the planner's {layout}"
    if unknown := [e.name for e in revision.effects if e.name not in catalogue()]:
        return f"effect {unknown[0]} is unknown"
    for name, value in revision.tyre.items():
        if not np.isfinite(value) or value <= 0:
            return f"tyre parameter {name} = {value}"
    for name in ("df", "dr", "d"):
        if not 0.3 <= revision.tyre.get(name, 1.0) <= 3.0:
            return f"peak factor {name} = {revision.tyre[name]:.3g} is outside 0.3..3"
    return ""


def _peaks(revised: RevisedModel, theta: Array) -> tuple[float, float]:
    """Peak factors D of front and rear."""
    names = [p.name for p in revised.model.tyre_table]
    front, rear = ("df", "dr") if "df" in names else ("d", "d")
    return float(theta[names.index(front)]), float(theta[names.index(rear)])


def usable_grip(revised: RevisedModel, knowledge: TyreKnowledge) -> float:
    """Share of the model's peak tyre force the speed profile may ask for, given load limits and belief.

    Eq. (10) holds at the sigma points, which stand for up to one sigma more force at the same slip.
    """
    names = [p.name for p in revised.model.tyre_table]
    shares = []
    for peak_name, limit in zip(("df", "dr") if "df" in names else ("d", "d"), knowledge.load_max, strict=True):
        i = names.index(peak_name)
        worst = knowledge.mean[i] + np.sqrt(max(knowledge.covariance[i, i], 0.0))
        shares.append(limit / max(worst, knowledge.theta[i]))
    return float(np.clip(PROFILE_SHARE * min(shares), 0.3, 0.95))
