"""What the other processes and a person say to the gateway: commands, plan, estimate, requests."""

from __future__ import annotations

from math import inf

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, FailsafeAction, OperatorAction, OperatorCommand
from hil_gateway.bus.outside import Navigation
from hil_gateway.bus.track_day.run import RunPhase
from hil_gateway.gateway.command_gate import CommandGate, Refusal
from hil_gateway.gateway.perceive.duration import NAMED_S, SILENT_S
from hil_gateway.gateway.requests import REQUESTS
from hil_gateway.process.clock import NS_PER_S

ESTIMATE_MAX_S = topics.ESTIMATE.deadline_s + SILENT_S
"""An estimate of an older state is none: so long it may be on its way, and be made. The state's stamp is the gateway's
own, so that what lay in a queue while the gateway or the estimator was held up does not pass for new."""
QUEUE = 64
"""messages of other processes in a period: 20 come of four receivers that send 500 a second each"""
REQUESTS_KEPT = 4096
"""Requests of a period that are all looked at: a flood of others does not displace the one to stop. So many to arm and
to crank are known again when they are delivered twice: a person makes some dozens a day. Beyond that the gateway has to
be restarted to be armed; none is ever forgotten and taken again."""


class NewestEstimate(Latest[Estimate]):
    """One of an old state is as dead as one that came long ago."""

    def alive(self, now_ns: int) -> bool:
        age_s = inf if self.message is None else (now_ns - self.message.state_stamp_ns) / NS_PER_S
        return super().alive(now_ns) and 0.0 <= age_s <= ESTIMATE_MAX_S


class Inbox:
    """Reads every subscription of the gateway once a period."""

    def __init__(self, bus: Bus, latency_max_s: float) -> None:
        """`latency_max_s`: commands about older states are not taken."""
        self._commands = [
            (bus.subscribe(topic, depth=QUEUE), topic is topics.JOYSTICK_COMMAND)
            for topic in (topics.COMMAND, topics.ROS2_COMMAND, topics.JOYSTICK_COMMAND)
        ]
        """and whether a person gives them"""
        self._operator = bus.subscribe(topics.OPERATOR, depth=REQUESTS_KEPT)
        self._navigation = bus.subscribe(topics.NAVIGATION, depth=QUEUE)
        self.plan = LatestReader(bus, topics.PLAN)
        self._estimates = bus.subscribe(topics.ESTIMATE)
        self.estimate = NewestEstimate(topics.ESTIMATE.deadline_s)
        self.run = LatestReader(bus, topics.RUN)
        """where in its run the planner says that the car is"""
        self._starts_seen: set[tuple[str, str, int, int]] = set()
        self.gate = CommandGate(latency_max_s)
        self.refused: dict[str, int] = {}
        self.second_source = ""
        """who sends commands without having the right to; empty: nobody, of late"""
        self._second_ns = 0

    @property
    def command_source(self) -> str:
        """Who has the right to command; empty before the first command."""
        return "" if self.gate.newest is None else self.gate.newest.source

    def read_commands(self, now_ns: int, action: FailsafeAction) -> None:
        """Offer every command that arrived to the gate."""
        for command, by_hand in [(c, by_hand) for source, by_hand in self._commands for c in source.poll(now_ns)]:
            refusal = self.gate.offer(command, now_ns, action, by_hand=by_hand)
            if refusal is not None:
                self.refused[refusal] = self.refused.get(refusal, 0) + 1
            if refusal is Refusal.SECOND_SOURCE:
                self.second_source, self._second_ns = command.source, now_ns
        if now_ns - self._second_ns > NAMED_S * NS_PER_S:
            self.second_source = self.gate.successor = ""

    def read_navigation(self, now_ns: int) -> list[Navigation]:
        """What receivers on the network have said, oldest first."""
        return self._navigation.poll(now_ns)

    def read_estimate(self, now_ns: int) -> Estimate | None:
        """The newest estimate, while it is valid or lacks the heading only, for which it then has the track's."""
        for estimate in self._estimates.poll(now_ns):
            self.estimate.put(estimate, now_ns)
        return self.estimate.message if usable(self.estimate, now_ns) else None

    def planner_starts(self, now_ns: int) -> bool:
        """Whether a planner has announced itself that cannot plan yet."""
        run = self.run.latest
        return run.alive(now_ns) and run.message is not None and run.message.phase is RunPhase.STARTING

    def read_request(self, now_ns: int) -> OperatorAction | None:
        """The most urgent request of a person that arrived this period."""
        asked = {message.action for message in self._operator.poll(now_ns) if self._counts(message)}
        if OperatorAction.TAKE_OVER in asked:
            self.gate.successor = self.second_source
        return next((action for action in REQUESTS if action in asked), None)

    def _counts(self, request: OperatorCommand) -> bool:
        """Whether a request is no second delivery of one to arm or crank; to stop twice does no harm."""
        if not REQUESTS[request.action].once:
            return True
        identity = (request.action, request.source, request.seq, request.stamp_ns)
        known = identity in self._starts_seen or len(self._starts_seen) >= REQUESTS_KEPT
        if not known:
            self._starts_seen.add(identity)
        return not known


def usable(estimate: Latest[Estimate], now_ns: int) -> bool:
    """Whether the newest estimate is valid, or all that it does not know is where the car points."""
    heading_only = estimate.message is not None and estimate.message.lacks == "heading"
    return estimate.valid(now_ns) or (heading_only and estimate.alive(now_ns))
