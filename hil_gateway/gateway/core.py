"""The gateway: frames in, vehicle state out; commands in, limited and supervised frames out (100 Hz).

A period has two phases: `observe` perceives (frames, messages) and decides (failsafe, ladder), `answer` acts
(actuation, limits, frames) and reports. In between, estimator and planner may answer what was observed; `step` is both
at once. Nothing here reads a clock, or raises anything but bugs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from hil_gateway.agreement import agreement
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import FailsafeAction, VehicleState
from hil_gateway.can_link import CanLink
from hil_gateway.car.actuation import Actuation
from hil_gateway.car.states import CtState
from hil_gateway.config import Config
from hil_gateway.gateway.act.actor import Actor, Period
from hil_gateway.gateway.decide.conditions import Conditions
from hil_gateway.gateway.decide.decision import Decision, Situation, decide
from hil_gateway.gateway.decide.failsafe import ROWS, Failsafe, Inputs
from hil_gateway.gateway.decide.ladder_inputs import caution_speed, flags_in_force, flags_received
from hil_gateway.gateway.perceive.dead_reckoning import DeadReckoning, Pose
from hil_gateway.gateway.perceive.inbox import Inbox
from hil_gateway.gateway.perceive.lateness import Lateness, brought_up
from hil_gateway.gateway.perceive.monitors.monitors import Monitors
from hil_gateway.gateway.perceive.monitors.receivers import OtherReceivers
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.stood import Stood
from hil_gateway.gateway.perceive.tyre_reports import TyreReports
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.gateway.reporter import Reporter
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track

Measures = Mapping[str, float]
"""name of a measure of the failsafe table -> seconds it has held"""


class _Observed(NamedTuple):
    """What the first phase of a period leaves to the second."""

    state: VehicleState
    motion: Motion
    pose: Pose | None
    situation: Situation


class Gateway:
    """Core of the gateway process.

    Without a `track` a stop holds the steering; `load` says, when asked, how busy the computer is.
    """

    def __init__(
        self, config: Config, bus: Bus, link: CanLink, track: Track | None = None, load: Callable[[], str] = str
    ) -> None:
        self._bus, self._link = bus, link
        codec, actuation = config.car.codec, Actuation(config.vehicle, config.powertrain)
        self.builder = VehicleStateBuilder(config, actuation)
        self.inbox = Inbox(bus, config.gateway.command_latency_max_s)
        self.monitors = Monitors(config, track)
        self._dead_reckoning = DeadReckoning(config.placing.noise)
        self._lateness = Lateness(self.builder)
        self._before_pause = self._dead_reckoning.now
        """what had been reckoned when frames last came: those that waited go on from there"""
        self._receivers = OtherReceivers(config.car, config.origin)
        self._tyres = TyreReports(self.builder)
        self._stood = Stood(config.car)
        ours = None if track is None else agreement(config, track)
        self._conditions = Conditions(self.builder, self._tyres, config, ours)
        self.decision = Decision()
        self._actor = Actor(config, codec, link, actuation, track)
        self._reporter = Reporter(config.gateway.mode, load)
        self._caution_speed = config.gateway.caution_speed
        self._seq = 0
        self.seen: tuple[VehicleState, Inputs] | None = None
        """what the newest period decided on"""
        self._observed: _Observed | None = None
        self.speed = 0.0
        """m/s in the newest period, by whatever sensors are left"""

    @property
    def failsafe(self) -> Failsafe:
        """What the failsafe has decided."""
        return self.decision.failsafe

    @property
    def shares(self) -> dict[str, float]:
        """Difference over bound of the monitors that compare with one, in this period."""
        return self.monitors.shares | {"other receivers": self._receivers.share}

    @property
    def why(self) -> str:
        """Who was late, or what is wrong with the fixes, where that is why the car is being stopped."""
        return self._reporter.why

    @property
    def moves_car(self) -> bool:
        """Whether the car moves by commands of this gateway, and can still hear them."""
        if self.seen is None or not (self.decision.failsafe.armed and self._actor.transmits):
            return False
        _, inputs = self.seen
        return not inputs.standing and not ROWS["can_silent"].fires(inputs.measures)

    def begin_ending(self) -> None:
        """From the next period on the table asks for a stop: this process is to end."""
        self._conditions.ending = True

    @property
    def newest_report_ns(self) -> int:
        """When the newest report of the car came."""
        return 0 if self._observed is None else self._observed.state.stamp_ns

    @property
    def awaits_command(self) -> bool:
        """Whether a planner's command is what leaves next; a stop waits for nobody."""
        return self.decision.action is FailsafeAction.DRIVE

    def has_command(self, now_ns: int) -> bool:
        """Whether the planner's command of this period has come, or none is due."""
        self.inbox.read_commands(now_ns, self.decision.action)
        return not self.inbox.gate.expects(now_ns)

    def step(self, now_ns: int) -> None:
        """One 10 ms period without time in between."""
        self.observe(now_ns)
        self.answer(now_ns)

    def observe(self, now_ns: int) -> None:
        """First phase: what the car reports, published, and what is decided on it."""
        before = self.decision
        state = self._read_car(now_ns, before)
        self._read_bus(now_ns, before)
        motion, pose, monitored = self._perceive(now_ns, state, before)
        self.speed = motion.speed
        self._stood.step(now_ns, state, self.inbox.estimate)
        situation = self._decide(now_ns, state, monitored, before)
        self._observed = _Observed(state, motion, pose, situation)

    def answer(self, now_ns: int) -> None:
        """Second phase: the command that has been read by now, or the gateway's own, on the wire."""
        assert self._observed is not None, "nothing was observed"
        state, motion, pose, situation = self._observed
        self._act(now_ns, state, motion, pose)
        self._report(situation)

    def _read_car(self, now_ns: int, before: Decision) -> VehicleState:
        """Frames that have arrived, to the published vehicle state."""
        self.builder.take(self._link.receive(0.0), now_ns)
        self.builder.hear(self.inbox.read_navigation(now_ns), now_ns)
        flags, late = flags_in_force(self.builder, now_ns), self.monitors.motion.steer_late
        state = self.builder.build(now_ns, before.race_control.ct_state, *flags, late)
        if (known := self._stood.estimate) is not None:
            state = state.model_copy(update={"stood": known})
        self._bus.publish(topics.VEHICLE_STATE, state)
        return state

    def _read_bus(self, now_ns: int, before: Decision) -> None:
        """Commands and plans."""
        self.inbox.read_commands(now_ns, before.action)
        self.inbox.plan.update(now_ns)

    def _perceive(self, now_ns: int, state: VehicleState, before: Decision) -> tuple[Motion, Pose | None, Measures]:
        """How the car moves and where it is, by the sources that fit each other, and what the monitors measure."""
        late_ns = self._read_lateness(now_ns)
        then = state.model_copy(update={"position_stamp_ns": state.fix_ns - late_ns}) if late_ns else state
        motion, pose, monitored = self._perceive_as_of(now_ns - late_ns, now_ns, then, before)
        if motion.speed == 0.0 or not before.stopping:
            self._lateness.forget()
        if late_ns:
            turned = self.monitors.motion.turned_within(late_ns / NS_PER_S)
            motion, pose = brought_up(motion, pose, state.ax, turned, late_ns / NS_PER_S)
        return motion, pose, monitored

    def _read_lateness(self, now_ns: int) -> int:
        """How late the frames of this period are, ns; what was reckoned while they waited is taken back, once."""
        paused, was_late = self._lateness.pauses, self._lateness.late_ns
        late_ns = self._lateness.step(now_ns)
        if self._lateness.pauses and not paused:
            self._before_pause = self._dead_reckoning.now
        if late_ns and not was_late:
            self._dead_reckoning.now = self._before_pause
        return late_ns

    def _perceive_as_of(
        self, then_ns: int, now_ns: int, state: VehicleState, before: Decision
    ) -> tuple[Motion, Pose | None, Measures]:
        """The same of `then_ns`, which what arrives now tells of; estimates from frames that are late say nothing."""
        monitors, in_time = self.monitors, now_ns == then_ns
        fixes_fitted, imu_was_wrong = monitors.fixes_fit, monitors.imu_wrong
        course = self.builder.fixes.course(now_ns)
        commanded = self._actor.on_wire if before.failsafe.armed and self._actor.transmits else None
        motion = monitors.motion.step(then_ns, state, course if fixes_fitted else None, commanded)
        reckoned = self._dead_reckoning.carry_on(then_ns, motion)
        monitors.position.step(then_ns, state, motion, reckoned, rolls=not before.stopping)
        outvoted_s = self._receivers.step(now_ns, self.builder)
        estimate = self.inbox.read_estimate(now_ns)
        if in_time:
            monitors.position.outvoted(outvoted_s)
            monitors.heed(now_ns, state, self.inbox.estimate, self._dead_reckoning.pose is not None)
        believed = estimate if monitors.estimate_fits and in_time else None
        pose = self._dead_reckoning.step(then_ns, state, motion, believed, monitors.fix_fits)
        monitored = monitors.measures(now_ns, state, pose, commanded, course, before.stopping, self._tyres.flat)
        found = monitors.imu_wrong and not imu_was_wrong
        if found:  # a stop that begins now must not go by what was false
            motion = monitors.motion.again(state, course)
        if course is not None and (found or pose is None):
            pose = self._dead_reckoning.restart(then_ns, course)
        return motion, pose, monitored

    def _decide(self, now_ns: int, state: VehicleState, monitored: Measures, before: Decision) -> Situation:
        """Failsafe and ladder of this period."""
        request, age_s = self.inbox.read_request(now_ns), self.inbox.gate.age_s(now_ns)
        situation = self._conditions.situation(
            now_ns, state, request, before, age_s, self.inbox.estimate, monitored,
            self.inbox.plan.latest, self.inbox.gate.newest, self.inbox.run.update(now_ns),
        )  # fmt: skip
        self.decision = decide(situation, before)
        self.seen = state, situation.conditions
        estimate_age_s = self.inbox.estimate.age_s(now_ns)
        fixes = {"position_wrong": self.monitors.position.source, "position_lost": self.builder.network.cause}
        self._reporter.note_change(situation, before, self.decision, estimate_age_s, fixes)
        if self.decision.stopping and not before.stopping:
            self._actor.start_stop()
        return situation

    def _act(self, now_ns: int, state: VehicleState, motion: Motion, pose: Pose | None) -> None:
        """Ladder and actuator commands on the wire, and what was sent on the bus."""
        decision, command, monitors = self.decision, self.inbox.gate.newest, self.monitors
        self._actor.report_ladder(now_ns, decision.race_control.ct_state, flags_received(self.builder))
        sent, limited = self._actor.step(Period(
            now_ns, state, motion, decision, command, pose, self._tyres.flat_front, self._tyres.flat_rear,
            monitors.blind, monitors.turns, monitors.steering_stands, monitors.steering_reversed,
            caution_speed(self.builder, self._caution_speed),
            monitors.motion.axles(motion.late_s, monitors.steering_reversed) if decision.stopping else None,
        ))  # fmt: skip
        self._reporter.measure_latency(now_ns, decision, command)
        self._bus.publish(topics.APPLIED, self._actor.applied(now_ns, self._seq, state, decision, sent, limited))
        self._seq += 1

    def _report(self, situation: Situation) -> None:
        """What is due more slowly: status and tyres."""
        status = self._reporter.status(situation, self.decision, self.builder, self._link, self._actor, self.inbox)
        if status is not None:
            self._bus.publish(topics.GATEWAY_STATUS, status)
        if (tyres := self._tyres.message(situation.now_ns)) is not None:
            self._bus.publish(topics.TYRES, tyres)

    def shut_down(self, now_ns: int) -> None:
        """Say controlled shutdown on the wire; the car stops by itself when the commands end."""
        self._actor.report_ladder(now_ns, CtState.CONTROLLED_SHUTDOWN, flags_received(self.builder))
