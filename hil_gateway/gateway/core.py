"""The gateway: frames in, vehicle state out; commands in, limited and supervised frames out (100 Hz).

`step` is one period: perceive (frames, messages), decide (failsafe, ladder), act (actuation, limits, frames), report.
It reads no clock and raises nothing but bugs.
"""

from __future__ import annotations

from collections.abc import Callable

from can_dbc.codec import load_codec
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import VehicleState
from hil_gateway.can_link import CanLink
from hil_gateway.car.actuation import Actuation
from hil_gateway.car.states import CtState
from hil_gateway.config import Config
from hil_gateway.gateway.act.actor import Actor
from hil_gateway.gateway.decide.conditions import Conditions
from hil_gateway.gateway.decide.decision import Decision, decide
from hil_gateway.gateway.decide.failsafe import Failsafe, Inputs
from hil_gateway.gateway.decide.ladder_inputs import caution_speed, flags_in_force, flags_received
from hil_gateway.gateway.perceive.course import CourseReader
from hil_gateway.gateway.perceive.dead_reckoning import DeadReckoning
from hil_gateway.gateway.perceive.inbox import Inbox
from hil_gateway.gateway.perceive.monitors.monitors import Monitors
from hil_gateway.gateway.perceive.tyre_reports import TyreReports
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.gateway.reporter import Reporter
from hil_gateway.track.track import Track


class Gateway:
    """Core of the gateway process.

    `track` lets a stop go on beyond the end of the last plan; `load` says, when asked, how busy the computer is.
    """

    def __init__(
        self, config: Config, bus: Bus, link: CanLink, track: Track | None = None, load: Callable[[], str] = str
    ) -> None:
        self._bus, self._link = bus, link
        codec, actuation = load_codec(), Actuation(config.vehicle, config.powertrain)
        self.builder = VehicleStateBuilder(config, codec, actuation)
        self.inbox = Inbox(bus, config.gateway.command_latency_max_s)
        self.monitors = Monitors(config, track)
        self._dead_reckoning = DeadReckoning(config.vehicle.lr)
        self._course = CourseReader()
        self._tyres = TyreReports(self.builder)
        self._conditions = Conditions(self.builder, self._tyres, config.gateway.mode)
        self.decision = Decision()
        self._actor = Actor(config, codec, link, actuation, track)
        self._reporter = Reporter(config.gateway.mode, load)
        self._caution_speed = config.gateway.caution_speed
        self._seq = 0
        self.seen: tuple[VehicleState, Inputs] | None = None
        """what the newest period decided on"""

    @property
    def failsafe(self) -> Failsafe:
        """What the failsafe has decided."""
        return self.decision.failsafe

    def step(self, now_ns: int) -> None:
        """One 10 ms period."""
        before, gate = self.decision, self.inbox.gate
        self.builder.take(self._link.receive(0.0), now_ns)
        state = self.builder.build(now_ns, before.race_control.ct_state, *flags_in_force(self.builder, now_ns))
        self._bus.publish(topics.VEHICLE_STATE, state)
        self.inbox.read_commands(now_ns, before.failsafe.armed)
        if (plan := self.inbox.read_plan(now_ns)) is not None:
            self._actor.stopping.take_plan(plan, stopping=before.stopping)
        fixes_fit, imu_wrong = self.monitors.fixes_fit, self.monitors.imu_wrong
        course = self._course.step(now_ns, self.builder.fixes)
        motion = self.monitors.motion.step(now_ns, state, course if fixes_fit else None)
        self.monitors.position.step(now_ns, state, motion, self._dead_reckoning.pose)
        self.monitors.position.scattered(now_ns, self._course.scatter_m)
        estimate = self.inbox.read_estimate(now_ns)
        self.monitors.heed(now_ns, state, self.inbox.estimate)
        fixes_fit = self.monitors.fixes_fit
        believed = estimate if self.monitors.estimate_fits else None
        pose = self._dead_reckoning.step(now_ns, state, motion, believed, fixes_fit)
        request = self.inbox.read_request(now_ns)
        commanded = self._actor.on_wire if before.failsafe.armed and self._actor.transmits else None
        trusted = None if self.monitors.position.wrong and not imu_wrong else course
        self.monitors.stopping = before.stopping
        monitored = self.monitors.measures(now_ns, state, pose, commanded, trusted)
        if course is not None and self.monitors.imu_wrong and not imu_wrong:
            self._dead_reckoning.restart(now_ns, course)
        situation = self._conditions.situation(
            now_ns, state, request, before, gate.age_s(now_ns), self.inbox.estimate, monitored
        )
        decision = self.decision = decide(situation, before)
        self.seen = state, situation.conditions
        self._reporter.note_change(situation, before, decision, self.inbox.estimate.age_s(now_ns))
        if decision.stopping and not before.stopping:
            self._actor.start_stop()
        self._actor.report_ladder(now_ns, decision.race_control.ct_state, flags_received(self.builder))
        self._actor.caution_speed = caution_speed(self.builder, self._caution_speed)
        sent, limited = self._actor.step(now_ns, state, motion, decision, gate.newest, pose)
        self._reporter.note_answer(now_ns, decision, gate.newest)
        self._bus.publish(topics.APPLIED, self._actor.applied(now_ns, self._seq, state, decision, sent, limited))
        status = self._reporter.status(situation, decision, self.builder, self._link, self._actor)
        if status is not None:
            self._bus.publish(topics.GATEWAY_STATUS, status)
        if (tyres := self._tyres.message(now_ns)) is not None:
            self._bus.publish(topics.TYRES, tyres)
        self._seq += 1

    def shut_down(self, now_ns: int) -> None:
        """Say controlled shutdown on the wire; the car stops by itself when the commands end."""
        self._actor.report_ladder(now_ns, CtState.CONTROLLED_SHUTDOWN, flags_received(self.builder))
