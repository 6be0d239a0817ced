"""The planner: estimate, belief and model revision in; plan and command out, 20 times a second (Algorithm 1)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimator.belief.revision import starting_revision
from hil_gateway.agreement import agreement
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import Applied, Estimate, Plan, PlanStatus
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.adoption.adoption import Adoption
from planner.fresh_plans import COLD_DISTANCE, FreshPlans, distance
from planner.line.joining import Joining
from planner.line.line_publisher import LinePublisher
from planner.line.pit_route import PitRoutes
from planner.line.track import Reference
from planner.plan.fallback import StopPlanner, Trajectory, shifted, stop_plan
from planner.plan.first_metres import WayLeft, straight_ahead
from planner.plan.from_rest import STILL, WALKING, Following, Unmoved, is_off, moves_off
from planner.plan.prediction import ActuatorModel, Car, InputCourse, PredictedMoment, Sent, credible, predict
from planner.plan.publishing import PlanDecision, Publisher, Stamps, within
from planner.problem.load_limits import LoadLimits, starting_limits, store_limits
from planner.problem.motion import DRIVE, PROGRESS, VX, S
from planner.problem.settings import settings_of
from planner.run.desk import RunDesk
from planner.run.expansion import Expansion
from planner.run.progress import Progress
from planner.solver.sqp import Stopwatch

MAX_SHIFT_S = 0.4
"""a shifted plan is used for this long at most; then the car is stopped"""
BRAKE_SHARE = 0.6
"""of the rear load limit a stop plan uses for braking; the rest is left for cornering"""


class Planner:
    """The planner behind the bus; `step` makes one plan and its command."""

    def __init__(
        self, config: Config, bus: Bus, track: Track | None = None,
        *, stopwatch: Stopwatch = lambda: 0, background: bool = False,
    ) -> None:  # fmt: skip
        self._config, self._bus, self._stopwatch = config, bus, stopwatch
        self.settings = settings_of(config)
        p = config.planner
        start = starting_revision(config, p.model)
        sustained = starting_limits(p)
        track = track or load_track(config.track)
        self._track = _declared_road(config, track)
        self.adoption = Adoption(config, self._track, self.settings, sustained, start, background=background)
        self._estimate: LatestReader[Estimate] = LatestReader(bus, topics.ESTIMATE)
        self._belief = LatestReader(bus, topics.BELIEF)
        self._revision = LatestReader(bus, topics.MODEL_REVISION)
        self._applied = bus.subscribe(topics.APPLIED, depth=50)
        self._actuators = ActuatorModel(config.car.actuators)
        self._plan: Trajectory | None = None
        self._seq = 0
        self._estimates_before = 0
        """that had come when a plan was prepared"""
        self.fresh = FreshPlans(p, self.settings, self.adoption, stopwatch)
        clearance = self.adoption.controller.clearance
        ways = self._track, config.vehicle.wheelbase, self.settings.limits, clearance
        lane = None if track.pit_lane is None else PitRoutes(*ways)
        self._following = Following(Joining(*ways), lane)
        self._unmoved = Unmoved()
        self._newest_applied: Applied | None = None
        self._teller = LinePublisher(bus)
        ours = agreement(config, track)
        self._publish = Publisher(config, bus, self._actuators, self.settings, ours)
        self._run = RunDesk(bus, _progress(config, self.adoption, ours.car), self._track, lane)

    def step(self, now_ns: int) -> Plan | None:
        """Plan from the newest estimate and publish; None while there has never been one."""
        self.prepare(now_ns)
        return self.plan(now_ns)

    def prepare(self, now_ns: int) -> None:
        """What does not need the estimate: it adds nothing to the age of the command, and leaves in the processor's
        caches what the plan needs next."""
        self._carry_on(now_ns)
        self._estimates_before = self._estimate.update(now_ns).count
        self._run.step(now_ns, 0.0 if self._plan is None else float(self._plan.z[S, 0]), self._base)
        self.adoption.cap_load(self._run.progress.caps.load_use)

    def has_news(self, now_ns: int) -> bool:
        """Whether an estimate has come since `prepare`."""
        return self._estimate.update(now_ns).count != self._estimates_before

    def plan(self, now_ns: int) -> Plan | None:
        """See `step`; once after `prepare`."""
        message = self._plan_and_publish(now_ns)
        self._adopt(now_ns)
        return message

    def _plan_and_publish(self, now_ns: int) -> Plan | None:
        started = self._stopwatch()
        start_ns = now_ns + round((self._config.planner.compute_s + self._config.car.actuators.first_motion) * NS_PER_S)
        z0 = self._initial_state(now_ns, start_ns)
        decision = self._first_metres(now_ns, start_ns) or self._decide(z0, start_ns, started)
        if decision is None:
            return None
        self._plan = decision.plan
        decision = self._or_not_moving(decision, now_ns)
        e = self._estimate.latest.message
        stamps = Stamps(now_ns, self._seq, 0 if e is None else e.state_stamp_ns)
        self._seq += 1
        return self._publish(decision, self.adoption.in_force, stamps, lambda: self._stopwatch() - started)

    @property
    def _base(self) -> Reference:
        """The race line with the speeds of the model in force."""
        return self.adoption.current.reference

    def store_limits(self) -> None:
        """Write the load limits the next run may use, if a file is configured."""
        if path := self._config.planner.load_limits:
            store_limits(path, self.next_limits())

    def next_limits(self) -> LoadLimits:
        """Loads the next run may start from."""
        return self.adoption.sustained

    def _carry_on(self, now_ns: int) -> None:
        """What was sent since the last plan, and a guess that is as old as that plan an interval on."""
        self._record(self._applied.poll(now_ns), now_ns)
        self.fresh.carry_on()

    def _adopt(self, now_ns: int) -> None:
        """What is believed of the car, after a plan, when there is time."""
        seen = self._belief.latest.count, self._revision.latest.count
        belief, revision = self._belief.update(now_ns), self._revision.update(now_ns)
        if belief.count != seen[0] and belief.message is not None:
            self.adoption.offer_belief(belief.message)
        if revision.count != seen[1] and revision.message is not None:
            self.adoption.offer(revision.message)
        self.adoption.advance()
        self.adoption.catch_up()
        if self._plan is not None:
            self._teller.step(now_ns, self.adoption.controller.reference.line, self.adoption.controller.clearance)

    def _record(self, applied: list[Applied], now_ns: int) -> None:
        """What the gateway sent, on the own clock: the newest counts as just sent."""
        self._newest_applied = applied[-1] if applied else self._newest_applied
        for message in applied:
            age_ns = applied[-1].stamp_ns - message.stamp_ns
            self._actuators.record(Sent(now_ns - age_ns, message.steer, self.adoption.delivered.acting(message.drive)))

    def _initial_state(self, now_ns: int, start_ns: int) -> Array | None:
        """z at `start_ns` predicted from the newest estimate; None where that is missing, stale or not credible."""
        latest = self._estimate.update(now_ns)
        e = latest.message
        if e is None or not latest.valid(now_ns) or latest.received_ns is None:
            return None
        car: Car = (e.x, e.y, e.yaw, e.vx, e.vy, e.yaw_rate)
        if not (credible(car, self._track) and math.isfinite(e.drive) and math.isfinite(e.steer)):
            return None
        self.adoption.take_delivered(e.delivered)
        self.adoption.take_late(e.steer_late)
        controller = self.adoption.controller
        controller.take_road(e.grade_share, e.bank_share)
        turns = round((float(controller.sqp.z[2, 0]) - e.yaw) / math.tau)
        car = (e.x, e.y, e.yaw + math.tau * turns, e.vx, e.vy, e.yaw_rate)
        measured_ns = latest.received_ns - round(self._config.planner.estimate_age_s * NS_PER_S)
        measured = PredictedMoment(measured_ns, car, self.adoption.delivered.acting(e.drive), e.steer)
        then = predict(self._actuators, controller.advance, measured, start_ns, self.adoption.late)
        if not then.finite:  # no model of the plan may end the process
            return None
        expected = self._expected(start_ns)
        near = expected is not None and math.hypot(then.car[0] - expected[0], then.car[1] - expected[1]) < COLD_DISTANCE
        s = self._locate(then, 0.0 if expected is None else float(expected[S]), near)
        self.adoption.watch(e, s)
        progress = then.car[3] if expected is None or not near else float(expected[PROGRESS])
        limits, (drive, steer) = self.settings.limits, self._take_sent(start_ns, expected)
        return np.array([*then.car, s, drive, steer, within(progress, 0.0, limits.speed)])

    def _take_sent(self, start_ns: int, expected: Array | None) -> tuple[float, float]:
        """Drive and steer that act at the start of the plan; the controller takes what is sent and acts later."""
        limits, late, actuators = self.settings.limits, self.adoption.late, self._actuators
        steer = self._ahead(actuators.steer_course, start_ns, late.steer)
        if self._newest_applied is not None and self._newest_applied.holding:
            # these brakes are the gateway's, which releases them for a command that carries the car
            held = 0.0 if expected is None else float(expected[DRIVE])
            drive, late = np.full(len(steer), held), late._replace(drive=0.0)
        else:
            drive = self._ahead(actuators.drive_course, start_ns, late.drive)
        acting = np.array([
            np.clip(drive, limits.drive_min, limits.drive_max), np.clip(steer, -limits.steer, limits.steer),
        ])  # fmt: skip
        self.adoption.controller.take_sent(acting, late)
        return float(acting[0, 0]), float(acting[1, 0])

    def _ahead(self, course: InputCourse, start_ns: int, late_s: float) -> Array:
        """(N+1,) values of an input that act at the stages, by what is sent."""
        dt, horizon = self.settings.dt, self.settings.horizon
        ahead_s = [dt * k - late_s for k in range(min(math.ceil(late_s / dt), horizon))]
        sent = [course.at(start_ns + round(s * NS_PER_S)) for s in (*ahead_s, 0.0)]
        return np.array(sent + sent[-1:] * (horizon + 1 - len(sent)))

    def _locate(self, then: PredictedMoment, last: float, near: bool) -> float:
        """Progress on what is the reference from now on; `last` expected, and whether the car is `near` there."""
        x, y, yaw, speed, *_ = then.car
        if not near:
            self._following.give_up()
        in_lane, coming = self._run.in_lane(x, y), self._run.coming(last, self._base.length)
        base = self._run.reference(self._following.path(self._base, last, in_lane, coming), last)
        reference = self._following.reference(base, last)
        s = reference.project(x, y, last) if near else reference.find(x, y, last)
        going = near and self.fresh.guess_start_ns is not None and speed > STILL
        if speed < WALKING and not going and is_off(reference, s, (x, y, yaw)):
            # a standing car turns its wheels before it moves
            self._following.begin(base, (x, y, yaw), then.steer if speed > STILL else 0.0)
            reference = self._following.reference(base, s)
            self.fresh.guess_start_ns = None  # a guess beside another path is none
        self.adoption.controller.reference = reference
        return reference.project(x, y, s)

    def _expected(self, start_ns: int) -> Array | None:
        """State the last plan has at `start_ns`."""
        if self._plan is None:
            return None
        k = round((start_ns - self._plan.start_ns) / (self.settings.dt * NS_PER_S))
        return self._plan.z[:, min(max(k, 0), self.settings.horizon)]

    def _decide(self, z0: Array | None, start_ns: int, started: int) -> PlanDecision | None:
        """A fresh plan if there is one, else the last one shifted, else a stop plan; None before the first estimate."""
        reason = "no valid estimate"
        if z0 is not None and (why := self._halts(z0)):
            self.fresh.forget()  # what is planned after it begins afresh
            plan = stop_plan(z0, start_ns, self.settings.horizon, self._stopping())
            return PlanDecision(plan, PlanStatus.STOP, why)
        if z0 is not None and not self._following.hindrance:
            solved = self.fresh.solve(z0, start_ns, started, self._expected(start_ns))
            self.adoption.judge(isinstance(solved, PlanDecision))
            if isinstance(solved, PlanDecision):
                return solved
            reason = solved
        elif z0 is not None:
            self.fresh.solved_ns, reason = 0, self._following.hindrance  # no plan of before leads on from here
        return self._fall_back(z0, start_ns, reason)

    def _halts(self, z0: Array) -> str:
        """Why the run has the car brake or stand, in words; empty where it goes on."""
        run, s, speed = self._run, float(z0[S]), float(z0[VX])
        run.slid(self.adoption.trust.slides)
        run.progress.advance(s, speed)
        return run.progress.halts(s, speed, self._stopping().deceleration)

    def _first_metres(self, now_ns: int, start_ns: int) -> PlanDecision | None:
        """Straight ahead while all that is not known is where the car points."""
        latest = self._estimate.latest
        e = latest.message
        if e is None or e.lacks != "heading" or not latest.alive(now_ns) or not credible(
            (e.x, e.y, e.yaw, e.vx, e.vy, e.yaw_rate), self._track
        ):  # fmt: skip
            return None
        base, stopping = self.adoption.current.reference, self._stopping()
        s = base.find(e.x, e.y, 0.0 if self._plan is None else float(self._plan.z[S, 0]))
        way = WayLeft.of(e, self._track, self.settings.limits.car_half_width, self.settings.sigma_level)
        self.fresh.forget()  # what is planned as soon as it is known begins afresh
        plan = straight_ahead(e, s, way, start_ns, self.settings.horizon, stopping)
        shows = moves_off(plan.z, self.settings.dt)
        reason = "the first metres show where the car points" if shows else way.reason
        return PlanDecision(plan, PlanStatus.FIRST_METRES, reason)

    def _or_not_moving(self, decision: PlanDecision, now_ns: int) -> PlanDecision:
        """The decision, or the same with why a standing car goes on standing."""
        speed = float(decision.plan.z[VX, 0])
        if speed < STANDSTILL and not moves_off(decision.plan.z, self.settings.dt):
            self._unmoved.forget()
            reason = decision.reason or "the solver finds no way to drive off"
        else:
            reason = self._unmoved.update(now_ns, self._newest_applied, speed)
        return replace(decision, status=PlanStatus.NOT_MOVING, reason=reason) if reason else decision

    def _fall_back(self, z0: Array | None, start_ns: int, reason: str) -> PlanDecision | None:
        """The last plan shifted while its solution is young and fits the state, then a stop plan."""
        stopping, rest = self._stopping(), None
        if self._plan is not None:
            ahead_s = (start_ns - self._plan.start_ns) / NS_PER_S
            rest = shifted(self._plan, max(0, round(ahead_s / self.settings.dt)), stopping)
        if rest is not None and start_ns - self.fresh.solved_ns <= MAX_SHIFT_S * NS_PER_S and _fits(rest, z0):
            return PlanDecision(rest, PlanStatus.SHIFTED, reason)
        if z0 is None and self._plan is not None:
            z0 = self._plan.z[:, -1] if rest is None else rest.z[:, 0]
        if z0 is None:
            return None
        return PlanDecision(stop_plan(z0, start_ns, self.settings.horizon, stopping), PlanStatus.STOP, reason)

    def _stopping(self) -> StopPlanner:
        controller, vehicle = self.adoption.controller, self._config.vehicle
        front, rear = controller.knowledge.load_left
        grip, force = min(front, rear), float(controller.knowledge.theta[0])
        braking = BRAKE_SHARE * rear * vehicle.static_load_rear / vehicle.mass
        return StopPlanner(
            lambda z, du: controller.sqp.propagate(z, du, controller.here, controller.common),
            controller.reference, self.settings.limits, self.settings.dt, vehicle, braking, grip, force,
        )  # fmt: skip


def _progress(config: Config, adoption: Adoption, car: str) -> Progress:
    """Runs of this car with the model that it starts with."""
    p, revision = config.planner, adoption.current.revision
    key = " ".join([car, revision.layout, *(effect.name for effect in revision.effects)])
    return Progress(adoption.current.reference.length, key, Expansion(p.run_caps), p.caps_without_run)


def _declared_road(config: Config, track: Track) -> Track:
    """Eq. (1)-(3) know no slopes; where they are all that is declared, what the road does is an effect to be found."""
    return track.level() if config.declared_model == "paper" else track


def _fits(plan: Trajectory, z0: Array | None) -> bool:
    """Whether a plan starts near the state, as far as that is known."""
    return z0 is None or distance(plan.z[:, 0], z0) < COLD_DISTANCE
