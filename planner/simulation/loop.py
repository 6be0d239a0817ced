"""The whole loop in one process on a virtual clock: plant, gateway, estimator, planner, CAN and bus between them.

Deterministic: one configuration and one seed give one drive. Nothing waits, so it runs as fast as the machine
computes. Faults enter at three places only: frames at a link, messages at a bus, and whether a component runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus, LocalSubscription
from hil_gateway.bus.messages import GatewayStatus, Message, OperatorAction, OperatorCommand, Plan
from hil_gateway.bus.topics import Topic
from hil_gateway.can_link import Frame, LinkStats, VirtualWire
from hil_gateway.can_link.wire import WireLink
from hil_gateway.config import Config
from hil_gateway.gateway.core import Gateway
from hil_gateway.gateway.decide.arming import DRIVES_OFF
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.plant.plant import Plant
from hil_gateway.process.clock import NS_PER_S, VirtualClock
from hil_gateway.receiver.core import Receivers
from hil_gateway.settings.gateway import PERIOD_NS
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

M = TypeVar("M", bound=Message)

LEARNER_PERIOD_NS = NS_PER_S // 10
UNIX_OFFSET_NS = 1_767_225_600 * NS_PER_S
"""virtual time begins in 2026: receivers tell GPS time"""
START_NS = NS_PER_S
"""virtual time does not start at zero: nothing may take 0 for 'never'"""


class Core(Protocol):
    """A process without its process."""

    def step(self, now_ns: int) -> object:
        """Do what is due at `now_ns`."""
        ...


class Faults:
    """No faults; subclasses override what they disturb."""

    def frames(self, now_ns: int, receiver: str, frames: list[Frame]) -> list[Frame]:
        """Frames as `receiver` ("plant", "gateway") gets them."""
        return frames

    def messages(self, now_ns: int, topic: Topic[Any], message: Message) -> Iterable[tuple[int, Message]]:
        """Deliveries (time, message) of one published message; none drops it, several duplicate it."""
        return ((now_ns, message),)

    def runs(self, now_ns: int, component: str) -> bool:
        """Whether a component ("plant", "receiver", "gateway", "estimator", "planner") gets its turn."""
        return True


class PipedReceivers:
    """The process that reads receivers, with what the plant's own send, and without sockets in between."""

    def __init__(self, config: Config, bus: LocalBus, plant: Plant) -> None:
        self._receivers, self._plant = Receivers(config, bus), plant
        for reader in self._receivers.readers.values():
            reader.begin()

    def step(self, now_ns: int) -> None:
        """What has arrived by now; GPS time is that of the loop's clock."""
        self._receivers.take(self._plant.receivers.due(now_ns), now_ns, self._plant.receivers.unix_offset_ns)
        self._receivers.step(now_ns)


class FaultyLink:
    """A link whose received frames pass through the faults."""

    kind = "wire"

    def __init__(self, link: WireLink, name: str, clock: VirtualClock, faults: Faults) -> None:
        self._link, self._name, self._clock, self._faults = link, name, clock, faults
        self.send = link.send
        self.close = link.close

    def receive(self, timeout_s: float = 0.0) -> list[Frame]:
        """See `CanLink.receive`."""
        return self._faults.frames(self._clock.now_ns(), self._name, self._link.receive(timeout_s))

    def stats(self) -> LinkStats:
        """See `CanLink.stats`."""
        return self._link.stats()


class FaultyBus(LocalBus):
    """A bus whose messages pass through the faults; late ones wait for their time in order of it."""

    def __init__(self, clock: VirtualClock, faults: Faults, tap: Callable[[int, Topic[Any], Message], None]) -> None:
        super().__init__()
        self._clock, self._faults, self._tap = clock, faults, tap
        self._late: list[tuple[int, int, Topic[Any], Message]] = []
        self._count = 0

    def publish(self, topic: Topic[M], message: M) -> None:
        now_ns = self._clock.now_ns()
        for due_ns, delivered in self._faults.messages(now_ns, topic, message):
            if due_ns <= now_ns:
                self._deliver(topic, delivered)
            else:
                self._count += 1
                self._late.append((due_ns, self._count, topic, delivered))

    def flush(self, now_ns: int) -> None:
        """Deliver what has become due."""
        due = sorted((entry for entry in self._late if entry[0] <= now_ns), key=lambda entry: entry[:2])
        self._late = [entry for entry in self._late if entry[0] > now_ns]
        for _, _, topic, message in due:
            self._deliver(topic, message)

    def _deliver(self, topic: Topic[Any], message: Message) -> None:
        self._tap(self._clock.now_ns(), topic, message)
        super().publish(topic, message)


@dataclass
class LoopResult:
    """What a drive came to. Times in s of virtual time, from when the car was armed."""

    laps: int = 0
    lap_times_s: list[float] = field(default_factory=list)
    distance_m: float = 0.0
    peak_speed: float = 0.0
    off_track: int = 0
    worst_margin_m: float = float("inf")
    """smallest distance of a wheel to the edge, negative outside"""
    friction_used: tuple[float, float] = (0.0, 0.0)
    """most of what front and rear axle could give that was used, by the plant"""
    friction_over_s: float = 0.0
    """longest time on end with an axle beyond the peak of its tyres"""
    slides: int = 0
    spins: int = 0
    seconds: float = 0.0
    armed: bool = False
    failsafes: list[tuple[float, str, str]] = field(default_factory=list)
    """(time, action, cause) whenever a stopping action begins"""
    plans: int = 0
    plan_failures: int = 0
    solve_ms: list[float] = field(default_factory=list)
    commands_sent: int = 0
    commands_limited: int = 0
    frames_lost: int = 0
    messages: dict[str, list[Message]] = field(default_factory=dict)
    """topic key -> messages in order, for the topics that were kept"""

    @property
    def clean(self) -> bool:
        """Nothing off track, no failsafe, no plan that was not a fresh solution."""
        return self.off_track == 0 and not self.failsafes and self.plan_failures == 0


class Loop:
    """The loop; `step` is 10 ms of everything, `run` drives until laps or time are done."""

    def __init__(
        self, config: Config, *, faults: Faults | None = None, keep: Sequence[Topic[Any]] = (),
        track: Track | None = None, arm: bool = True, components: dict[str, Callable[..., Core]] | None = None,
        timed: bool = False, simulated: SimulatedCar | None = None,
    ) -> None:  # fmt: skip
        """`keep`: topics whose messages go into the result. `components` replaces "estimator" or "planner" by another
        factory(config, bus, track), or adds a "learner". `timed`: the planner measures its solver with the machine's
        clock, and is late when that is late: realistic, and no longer the same every time. `simulated`: the car of the
        plant, in place of the configuration's; nothing else hears of it."""
        self.clock = VirtualClock(START_NS)
        self.faults = faults or Faults()
        self.wire = VirtualWire(self.clock)
        self.bus = FaultyBus(self.clock, self.faults, self._take_note)
        self.result = LoopResult(messages={topic.key: [] for topic in keep})
        self._arm, self._asked, self._armed_ns = arm, 0, 0
        track = track or load_track(config.track)
        self.plant = Plant(config, self._link("plant"), self.bus, track, simulated)
        self.plant.receivers.unix_offset_ns = UNIX_OFFSET_NS
        self.gateway = Gateway(config, self.bus, self._link("gateway"), track)
        made = {**_default_components(timed), **(components or {})}
        self.estimator = made["estimator"](config, self.bus, track)
        self.planner = made["planner"](config, self.bus, track)
        self._status: LocalSubscription[GatewayStatus] = self.bus.subscribe(topics.GATEWAY_STATUS)
        self._schedule: tuple[tuple[str, Core, int], ...] = (
            ("plant", self.plant, PERIOD_NS),
            *((("receiver", PipedReceivers(config, self.bus, self.plant), PERIOD_NS),) if config.receivers else ()),
            ("gateway", self.gateway, PERIOD_NS),
            ("estimator", self.estimator, PERIOD_NS),
            ("planner", self.planner, topics.PLAN.period_ns),
            *((("learner", made["learner"](config, self.bus, track), LEARNER_PERIOD_NS),) if "learner" in made else ()),
        )

    def _link(self, name: str) -> FaultyLink:
        return FaultyLink(self.wire.link(), name, self.clock, self.faults)

    @property
    def elapsed_s(self) -> float:
        """Virtual time since the start."""
        return (self.clock.now_ns() - START_NS) / NS_PER_S

    def step(self) -> None:
        """Advance everything by 10 ms, in the order of the data flow."""
        self.clock.advance(PERIOD_NS)
        now_ns = self.clock.now_ns()
        self.bus.flush(now_ns)
        for name, core, period_ns in self._schedule:
            if (now_ns - START_NS) % period_ns == 0 and self.faults.runs(now_ns, name):
                core.step(now_ns)
        for status in self._status.poll(now_ns):
            self._operate(now_ns, status)

    def run(self, laps: int | None = None, seconds: float | None = None, time_limit_s: float = 600.0) -> LoopResult:
        """Drive until `laps` are complete or the gateway has stopped the car, `seconds` have passed since arming, or
        the limit is reached."""
        while self.elapsed_s < time_limit_s:
            self.step()
            driven_s = (self.clock.now_ns() - self._armed_ns) / NS_PER_S if self._armed_ns else 0.0
            if laps is not None and (self.plant.referee.laps >= laps or self._stopped):
                break
            if seconds is not None and driven_s >= seconds:
                break
        return self.finish()

    @property
    def _stopped(self) -> bool:
        """Whether the car stands after a stop: nobody arms again, so no lap is to come."""
        return bool(self.result.failsafes) and self.plant.car.standing

    def finish(self) -> LoopResult:
        """The result so far."""
        result, referee = self.result, self.plant.referee
        result.laps, result.lap_times_s = referee.laps, list(referee.lap_times_s)
        result.distance_m, result.peak_speed = referee.distance_m, referee.peak_speed
        result.off_track, result.worst_margin_m = referee.off_track_count, referee.worst_margin_m
        loads = referee.loads
        result.friction_used, result.friction_over_s = loads.friction, loads.longest_over_s
        result.slides, result.spins = loads.slides, loads.spins
        result.seconds = (self.clock.now_ns() - self._armed_ns) / NS_PER_S if self._armed_ns else 0.0
        return result

    def ask(self, action: OperatorAction) -> None:
        """A person's request, which the gateway answers in its next period."""
        self._asked += 1
        now_ns = self.clock.now_ns()
        request = OperatorCommand(stamp_ns=now_ns, seq=self._asked, source="loop", action=action)
        self.bus.publish(topics.OPERATOR, request)

    def _operate(self, now_ns: int, status: GatewayStatus) -> None:
        """The person at the car: cranks and arms once, when nothing is missing."""
        self.result.commands_sent, self.result.commands_limited = status.commands_sent, status.commands_limited
        self.result.frames_lost = status.frames_lost
        if status.armed and not self.result.armed:
            self.result.armed, self._armed_ns = True, now_ns
        if self._arm and not self.result.armed:
            if not status.missing_for_crank:
                self.ask(OperatorAction.CRANK)
            if not status.missing_for_arming:
                self.ask(OperatorAction.ARM)
        stopping = status.action.endswith("stop")
        if stopping and (not self.result.failsafes or self.result.failsafes[-1][1:] != (status.action, status.cause)):
            self.result.failsafes.append((self.elapsed_s, status.action, status.cause))

    def _take_note(self, now_ns: int, topic: Topic[Any], message: Message) -> None:
        if topic.key in self.result.messages:
            self.result.messages[topic.key].append(message)
        if isinstance(message, Plan) and self.result.armed:
            self.result.plans += 1
            self.result.plan_failures += message.status not in DRIVES_OFF
            self.result.solve_ms.append(message.solve_ms)


def _default_components(timed: bool) -> dict[str, Callable[..., Core]]:
    from estimator.node import Estimator
    from planner.node import Planner

    stopwatch: Callable[[], int] = time.perf_counter_ns if timed else lambda: 0

    def planner(config: Config, bus: LocalBus, track: Track) -> Core:
        return Planner(config, bus, track, stopwatch=stopwatch)

    return {"estimator": Estimator, "planner": planner}
