"""Which model the planner drives with: model revisions taken over without missing a plan, and given back if bad.

New parameter values are written into the running controller and approached slowly. Another list of active effects
needs new compiled functions: they are built beside the running planner and swapped in between two plans. A revision
that makes plans fail soon after is rolled back and not tried again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimator.belief.revision import RevisedModel, model_of
from estimator.model.parameters import Quantity
from hil_gateway.bus.delivered import Delivered
from hil_gateway.bus.messages import Belief, Estimate, ModelRevision
from hil_gateway.config import Config
from hil_gateway.track.track import Track
from planner.adoption.brake_doubt import brake_spread
from planner.adoption.delivered import DeliveredShares
from planner.adoption.knowledge import GripState, Reserves, TyreNames, at_rest, next_knowledge
from planner.adoption.plausible import implausible, near
from planner.adoption.trust import Trust, slides
from planner.adoption.usable_grip import PROFILE_SHARE, sustained_next
from planner.line.envelope import SPEED_LEFT, Brakes, envelope_of
from planner.line.raceline import OptimisedLine, raceline_for
from planner.line.track import Reference
from planner.plan.controller import Controller, TyreKnowledge
from planner.plan.prediction import Late
from planner.plan.publishing import InForce
from planner.problem.load_limits import LoadLimits, judged_limits
from planner.problem.mpcc import Problem
from planner.problem.settings import Settings
from planner.solver.functions import Functions, build_functions, build_in_child

PROFILE_CHANGE = 0.01
"""relative change of usable grip that is worth a new speed profile"""
NOTHING_ASKED = (np.inf,) * 4
"""what a speed profile that is to be made again was made with"""
PROBATION = 40
"""plans after an adoption during which failures count against the new revision"""
PROBATION_FAILURES = 3
Effects = tuple[str, ...]


@dataclass
class Adopted:
    """A controller with the revision it was built for."""

    revision: ModelRevision
    revised: RevisedModel
    tyre: TyreNames
    controller: Controller
    reference: Reference
    """the race line with the speeds of this model"""


class Adoption:
    """The model in force; `offer` revisions and beliefs, call `advance` and `catch_up` between two plans."""

    def __init__(
        self, config: Config, track: Track, settings: Settings, sustained: LoadLimits, revision: ModelRevision,
        *, background: bool = False,
    ) -> None:  # fmt: skip
        self._config, self._track, self._settings = config, track, settings
        self.sustained = sustained
        """loads over axle load that the car has held, in this run or an earlier one"""
        self._background = background
        self.load_cap = 1.0
        """share of the grip that the speeds of the race line may use"""
        self._lap, self._sustained_by_lap = 0, LoadLimits(0.0, 0.0)
        self._belief: Belief | None = None
        self._refused: set[str] = set()
        self._given_back: set[Effects] = set()
        self._foreign = False
        """the estimator works with other effects than the model in force"""
        self._start = revision
        self._previous: Adopted | None = None
        self._ready: Adopted | None = None
        self._worker: threading.Thread | None = None
        self._new_reference: Reference | None = None
        self._spread: tuple[ModelRevision, tuple[float, float]] | None = None
        """a revision and its `brake_spread`: several steps lead to it"""
        self._changed, self._held_then = True, (0.0, 0.0)
        """whether a further step changes what is known of the tyres, and what was held at the last one"""
        self._probation = self._failures = 0
        self.delivered = DeliveredShares()
        self.corrected = config.estimator.learn or not self._by_data_sheet
        """whether data correct the model; else every lap is like the first, and no load held counts"""
        self._front_response = None if self.corrected else np.inf
        self._steer_late_s = 0.0
        self.notes: list[str] = []
        """what was refused or rolled back, and why; newest last"""
        self._line: OptimisedLine | None = None
        self._last: Reference | None = None
        """made last, with the path of all of them"""
        self._asked = NOTHING_ASKED
        self.current = self._adopt(revision, build_functions)

    @property
    def controller(self) -> Controller:
        """The controller to plan with."""
        return self.current.controller

    @property
    def in_force(self) -> InForce:
        """What a plan is published of."""
        return InForce(self.controller, self.current.revision.revision, self.delivered.sent, self.late)

    @property
    def late(self) -> Late:
        """How much later than they are reported the inputs act: by the model, and the steering as driving shows."""
        return Late(max(self.current.revised.constant(Quantity.DRIVE_DELAY) or 0.0, 0.0), self._steer_late_s)

    def offer(self, revision: ModelRevision) -> None:
        """Consider a revision from the estimator."""
        self._foreign = _effects(revision) != _effects(self.current.revision)
        if revision.revision in self._refused:
            return
        if _effects(revision) in self._given_back:
            return
        if reason := implausible(revision, self._start):
            self._refuse(revision, reason)
        elif not self._foreign:
            revised = model_of(revision, self._config.vehicle, self._track.length)
            self.current.revision, self.current.revised = revision, revised
            self.controller.phi_at = revised.phi_at
            self._changed = True
        elif self._worker is None:
            self._build(revision)

    def offer_belief(self, belief: Belief) -> None:
        """Use a belief for Eq. (7) and (10), if it fits the model and is not far from it."""
        if self._foreign:
            return  # tyres beside other effects are other tyres
        if belief.names == self.current.tyre.names and near(belief.mean, self.current.revised.theta):
            self._belief, self._changed = belief, True

    def advance(self) -> None:
        """Move parameters towards the revision in force and swap in what was built meanwhile."""
        if self._ready is not None:
            self._swap(self._ready)
        if self._new_reference is not None:
            self.current.reference, self._new_reference = self._new_reference, None
        held = self._held
        if not self._changed and held == self._held_then:
            return
        current, before, self._held_then = self.current, self.controller.knowledge, held
        knowledge = self._knowledge(before, current.revised, current.tyre, current.revision)
        self.controller.set_knowledge(knowledge)
        self._changed = not at_rest(knowledge, current.revised, current.tyre, current.revision, self._reserves)

    def take_late(self, steer_s: float) -> None:
        """The road wheels follow the reported angle so much later, s."""
        self._steer_late_s = steer_s

    def take_delivered(self, delivered: Delivered | None) -> None:
        """Plan at once with what tyres and brakes deliver now."""
        if not self._by_data_sheet:
            return
        if not self.corrected and delivered is not None and delivered.front is not None:
            self._front_response, self._changed = delivered.front, True
        brakes = self.delivered.brakes
        if self.delivered.take(delivered):
            self._changed = True
            self._asked = self._asked if self.delivered.brakes == brakes else NOTHING_ASKED
            self.advance()

    def watch(self, estimate: Estimate, s: float) -> None:
        """Where the car slides at progress `s`, ask for less at that place from now on."""
        current, knowledge = self.current, self.controller.knowledge
        if self.trust.watch(slides(estimate, knowledge, self._config.vehicle, current.tyre.axles), s):
            self._asked, self._changed = NOTHING_ASKED, True
        self.begin_lap(int(s // self.controller.reference.length))

    def cap_load(self, share: float) -> None:
        """Let speeds use this share of the grip from now on."""
        if share != self.load_cap:
            self.load_cap, self._asked = share, NOTHING_ASKED

    def begin_lap(self, lap: int) -> None:
        """What was held in the laps before `lap` may be asked for again; nothing where the model is no better known."""
        if lap > self._lap and self.corrected:
            self._lap, self._sustained_by_lap, self._changed = lap, self.sustained, True

    def judge(self, accepted: bool) -> None:
        """Outcome of a plan with the model in force; rolls a new model back that keeps failing."""
        if self._probation == 0:
            return
        self._probation -= 1
        self._failures += not accepted
        if self._failures >= PROBATION_FAILURES and self._previous is not None:
            self._refuse(self.current.revision, "plans with it failed, rolled back")
            self._given_back.add(_effects(self.current.revision))
            self.current, self._previous, self._probation = self._previous, None, 0

    @property
    def _by_data_sheet(self) -> bool:
        """Whether the belief begins with what is declared of this car; Eq. (1) to (3) alone explain too little of one
        to tell its axles' balance or what they deliver."""
        return self._config.declared_model == "race_car"

    @property
    def _held(self) -> tuple[float, float]:
        """Forces over axle load that were held, and may be counted on."""
        return sustained_next(self.sustained.pair, self._sustained_by_lap.pair)

    @property
    def _reserves(self) -> Reserves:
        """What is kept back now."""
        return Reserves.of(
            self._config.planner.load_use, self._settings.sigma_level, self._by_data_sheet, self._lap,
            self._front_response,
        )  # fmt: skip

    def _refuse(self, revision: ModelRevision, reason: str) -> None:
        self._refused.add(revision.revision)
        self.notes = [*self.notes[-99:], f"revision {revision.revision}: {reason}"]

    def _build(self, revision: ModelRevision) -> None:
        build = build_in_child if self._background else build_functions

        def work() -> None:
            try:
                self._ready = self._adopt(revision, build)
            except RuntimeError as error:
                self._refuse(revision, str(error))

        self._run(work)

    def _adopt(self, revision: ModelRevision, build: Callable[[Problem], Functions]) -> Adopted:
        revised = model_of(revision, self._config.vehicle, self._track.length)
        tyre = TyreNames.of(revised)
        problem = Problem(revised.model, self._settings)
        functions = build(problem)
        knowledge = self._knowledge(None, revised, tyre, revision)
        reference = self._reference(revised, tyre, knowledge)
        backend = self._config.planner.backend
        controller = Controller(problem, functions, reference, knowledge, phi_at=revised.phi_at, backend=backend)
        return Adopted(revision, revised, tyre, controller, reference)

    def _swap(self, new: Adopted) -> None:
        """Carry the guess over: the new model starts from the plan of the old one."""
        old = self.controller.sqp
        new.controller.sqp.set_guess(old.z.copy(), old.du.copy())
        knowledge, limits = new.controller.knowledge, self.controller.knowledge.load_max
        peaks = [new.revised.theta[d] for _, _, d in new.tyre.axles]
        judged = judged_limits(self._config.planner.load_use, np.array(peaks), limits)
        new.controller.set_knowledge(replace(knowledge, load_max=judged))
        self._previous, self.current, self._ready, self._belief = self.current, new, None, None
        self._probation, self._failures, self._changed = PROBATION, 0, True

    def _knowledge(
        self, before: TyreKnowledge | None, revised: RevisedModel, tyre: TyreNames, revision: ModelRevision
    ) -> TyreKnowledge:
        """Tyre parameters one slew step from those `before` towards the revision, with the newest belief."""
        belief = self._belief if before is not None else None  # a model being built has its own tyres
        known = self._spread
        if known is None or known[0] is not revision:
            known = self._spread = revision, brake_spread(revision)
        state = GripState(self.delivered, self._held, self._reserves, known[1])
        return next_knowledge(before, revised, tyre, revision, belief, state)

    def _reference(self, revised: RevisedModel, tyre: TyreNames, knowledge: TyreKnowledge) -> Reference:
        """Race line of a model, or the line in use with the speed profile of this model."""
        peaks = [knowledge.theta[d] for _, _, d in tyre.axles]
        front, rear = (PROFILE_SHARE * asked / peak for asked, peak in zip(knowledge.capacity, peaks, strict=True))
        at_start = revised.phi_at(np.zeros(1))[:, 0]
        top = self._settings.limits.speed - SPEED_LEFT
        envelope = envelope_of(
            revised.model,
            list(knowledge.theta),
            list(at_start),
            use=(front, rear),
            max_speed=top,
            car=self._config.declared_car,
            brakes=Brakes(self._settings.brakes, knowledge.brake_ratio, knowledge.brake_doubt),
        ).braked(self.delivered.brakes * self._config.powertrain.hardest_braking / self._config.vehicle.mass)
        if self._line is None:
            self._line = raceline_for(self._track, envelope, self._settings.limits.race_line_margin)
            self.trust = Trust(len(self._line.s), self._line.length)
        self._line = self._line.with_envelope(envelope, self.load_cap * self.trust.share)
        self._asked = (*knowledge.capacity, *knowledge.brake_doubt)
        self._last = Reference(self._line, self._last)
        return self._last

    def catch_up(self) -> None:
        """New speed profile on the same path when the usable grip has changed: some ms, beside the planner."""
        current, knowledge = self.current, self.controller.knowledge
        asked = *knowledge.capacity, *knowledge.brake_doubt
        changes = [abs(now - then) / now for now, then in zip(asked, self._asked, strict=True)]
        if max(changes) < PROFILE_CHANGE or self._worker is not None:
            return
        self._run(lambda: self._take_reference(self._reference(current.revised, current.tyre, knowledge)))

    def _take_reference(self, reference: Reference) -> None:
        self._new_reference = reference

    def _run(self, work: Callable[[], None]) -> None:
        """Do `work` in the worker thread, or at once where everything is to be deterministic."""
        if not self._background:
            work()
            return

        def guarded() -> None:
            try:
                work()
            finally:
                self._worker = None

        self._worker = threading.Thread(target=guarded, name="planner worker", daemon=True)
        self._worker.start()


def _effects(revision: ModelRevision) -> Effects:
    return tuple(effect.name for effect in revision.effects)
