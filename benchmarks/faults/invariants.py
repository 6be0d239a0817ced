"""What must hold whatever goes wrong: the promises, checked in every tick from outside the gateway."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from benchmarks.promises.wire_judge import DLC, Judge
from hil_gateway.bus.messages import Applied, FailsafeAction, Message, VehicleState
from hil_gateway.bus.topics import COMMAND, ESTIMATE
from hil_gateway.can_link.wire import WireLink
from hil_gateway.plant.controller.ladder import CarState
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_NS
from planner.simulation.loop import Loop

TICK_S = PERIOD_NS / NS_PER_S
STOPPING = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)
ACTUATORS = frozenset({0x578, 0x579, 0x57A, 0x57B})


@dataclass
class Watch:
    """Listens to wire and bus; `broken` names the first promise that did not hold."""

    loop: Loop
    ear: WireLink
    judge: Judge = field(default_factory=Judge)
    broken: str = ""
    action: FailsafeAction = FailsafeAction.DRIVE
    gateway_ns: int = 0
    """when the gateway last ran"""
    command_ns: int = 0
    state_bad_ns: int | None = None
    estimate_good_ns: int = 0
    """stamp of the newest state that a valid estimate answers; 0.1 s later it is too old, 50 ms later the car stops"""
    stopped_ns: int | None = None
    severity: FailsafeAction = FailsafeAction.DRIVE

    def __post_init__(self) -> None:
        now_ns = self.loop.clock.now_ns()
        self._commands = self.loop.bus.subscribe(COMMAND, depth=64)
        self._estimates = self.loop.bus.subscribe(ESTIMATE, depth=64)
        self.gateway_ns = self.command_ns = self.estimate_good_ns = now_ns

    def published(self, now_ns: int, message: Message) -> None:
        """One message as the gateway sent it, before any fault."""
        if isinstance(message, Applied):
            self.gateway_ns, self.action = now_ns, message.action
            self._finite("applied", (message.steer, message.drive))
        elif isinstance(message, VehicleState):
            bad_since = self.state_bad_ns or now_ns
            self.state_bad_ns = None if message.valid else bad_since
            self._finite("state", (message.ax, message.ay, message.yaw_rate, message.steer, message.drive))

    def check(self, now_ns: int) -> None:
        """All invariants of one tick."""
        ran = self.gateway_ns == now_ns
        if self._commands.poll(now_ns):
            self.command_ns = now_ns
        for estimate in self._estimates.poll(now_ns):
            if estimate.valid and estimate.state_stamp_ns <= now_ns:
                self.estimate_good_ns = max(self.estimate_good_ns, estimate.state_stamp_ns)
        self._check_wire(ran)
        if ran:
            self._check_reactions(now_ns)
            self._check_latch(now_ns)

    def _check_wire(self, ran: bool) -> None:
        """S1, S3, S4 on the bytes; L5: a gateway that does not run sends nothing."""
        frames = [frame for frame in self.ear.receive() if frame.id in DLC]
        for frame in frames:
            self.judge.take(frame.id, frame.data)
        if self.judge.faults:
            self._break("S1/S3/S4", self.judge.faults[0])
        if frames and not ran:
            self._break("L5", "frames left although the gateway did not run")

    def _check_reactions(self, now_ns: int) -> None:
        """L1 and L2: whoever is still driving has fresh commands, a valid state and a valid estimate."""
        driving = self.action is FailsafeAction.DRIVE
        command_s = (now_ns - self.command_ns) / NS_PER_S
        if driving and command_s > 0.1 + 2 * TICK_S:
            self._break("L1", f"driving on a command delivered {command_s:.3f} s ago")
        if self.action is not FailsafeAction.EMERGENCY_STOP and command_s > 0.5 + 2 * TICK_S:
            self._break("L1", f"no emergency stop although the last command is {command_s:.3f} s old")
        if driving and self.state_bad_ns is not None and now_ns - self.state_bad_ns > 0.06 * NS_PER_S:
            self._break("L2", "driving on an invalid state")
        if driving and now_ns - self.estimate_good_ns > (0.15 + 2 * TICK_S) * NS_PER_S:
            self._break("L2", "driving without a valid estimate")

    def _check_latch(self, now_ns: int) -> None:
        """S5: nobody arms here, so an action never falls."""
        order = list(FailsafeAction)
        if order.index(self.action) < order.index(self.severity):
            self._break("S5", f"{self.severity.value} fell back to {self.action.value} without being armed again")
        self.severity = max(self.severity, self.action, key=order.index)
        if self.action in STOPPING and self.stopped_ns is None:
            self.stopped_ns = now_ns

    def finish(self, frames_reach_the_car: bool) -> None:
        """At the end: whoever began to stop long enough ago stands, by the gateway's brakes or the car's own."""
        if self.stopped_ns is None or not frames_reach_the_car:
            return
        since_s = (self.loop.clock.now_ns() - self.stopped_ns) / NS_PER_S
        state = self.loop.plant.controller.state
        if since_s > STOP_WITHIN_S and not self.loop.plant.car.standing:
            speed = self.loop.plant.car["vx"]
            self._break("L1", f"still at {speed:.1f} m/s {since_s:.1f} s after the stop began ({CarState(state).name})")

    def _finite(self, what: str, values: tuple[float, ...]) -> None:
        if not all(map(math.isfinite, values)):
            self._break("F1", f"{what} is not finite: {values}")

    def _break(self, promise: str, text: str) -> None:
        self.broken = self.broken or f"{promise}: {text}"


STOP_WITHIN_S = 11.0
"""From 60 m/s at 6 m/s2, with a second to spare."""
