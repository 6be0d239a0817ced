"""One run of the demo: processes up, armed, driven, judged, and down again."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from enum import StrEnum

from hil_gateway.bus.messages import OperatorAction
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.demo.monitor import Monitor
from hil_gateway.demo.operator import Operator
from hil_gateway.demo.options import DemoOptions, DemoSetup
from hil_gateway.demo.referee import DriveReferee
from hil_gateway.demo.view import Scene, View, before_arming
from hil_gateway.process.clock import NS_PER_S, Clock, SystemClock
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.supervisor import Exit, Supervisor

PERIOD_NS = NS_PER_S // 20
START_S = 180.0
"""the planner may have to compile its functions the first time"""
RECORDER_READY_S = 5.0
STOP_S = 20.0
"""a car at full speed stands within this after a stop began"""
OWN_STOP_S = 1.0
"""the gateway has stopped the car by itself within this, or the operator does"""
STUCK_S = 15.0
CPU_PERIOD_NS = NS_PER_S


class Ending(StrEnum):
    """Why a run ended."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    PROCESS_DIED = "process died"
    STOPPED = "stopped by the gateway"
    NEVER_STARTED = "never started"
    NOT_MOVING = "not moving"


@dataclass
class RunResult:
    """What the summary is made of."""

    monitor: Monitor
    referee: DriveReferee
    ending: Ending = Ending.DONE
    exits: list[Exit] = field(default_factory=list)
    zero_ns: int = 0
    """event times count from here: when the car was first driven by commands, before that the start of the run"""
    cpu_share: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    signal: int = 0
    """number of the signal that ended it; 0: none did"""


class Run:
    """State of one run; `drive` is its whole life."""

    def __init__(
        self, options: DemoOptions, setup: DemoSetup, supervisor: Supervisor, view: View, stopping: StopRequest
    ) -> None:
        self._options, self._setup, self._supervisor, self._view = options, setup, supervisor, view
        self._stopping = stopping
        self._clock: Clock = SystemClock()
        self._bus = open_bus(setup.config.zenoh, "operator")
        self._operator = Operator(self._bus, asks=not options.stay)
        self.result = RunResult(Monitor(self._bus), DriveReferee(self._bus))
        self._started_ns = self.result.zero_ns = self._clock.now_ns()
        self._under_way_ns: int | None = None
        self._moved_ns = self._started_ns
        self._stop_ns: int | None = None
        self._distance_m = 0.0
        self._told = 0
        self._rest_started = False
        self._asked_to_stop = False
        self._interrupted_ns: int | None = None
        self._cpu = CpuMeter(supervisor)

    def drive(self) -> RunResult:
        """Run until the extent is reached, the car has been stopped, or the user has had enough."""
        try:
            while (ending := self._step()) is None:
                self._clock.sleep_until(self._clock.now_ns() + PERIOD_NS)
            self.result.ending = ending
        finally:
            self.result.seconds = self._driving_s(self._clock.now_ns())
            self.result.cpu_share = self._cpu.share()
            self.result.signal = self._stopping.signal
        return self.result

    def close(self) -> None:
        """Leave the bus (after the processes have, which would still be talking to it)."""
        self._bus.close()

    def _step(self) -> Ending | None:
        now_ns = self._clock.now_ns()
        monitor, referee = self.result.monitor, self.result.referee
        monitor.update(now_ns, self._operator.driving)
        referee.update(now_ns)
        self._operator.update(monitor.status, now_ns)
        if self._operator.driving and self._under_way_ns is None:
            self._under_way_ns = self.result.zero_ns = now_ns
            self._cpu.restart()
            self._tell("under way")
        if self._cpu.update(now_ns) and self._under_way_ns is not None:
            self._supervisor.prefer_real_time()  # again every second: for threads that were started meanwhile
        self._start_rest(now_ns)
        self._watch_processes(now_ns)
        self._watch_gateway(now_ns)
        for text in monitor.journal.news():
            self._view.say(text)
        self._view.show(self._scene(now_ns))
        return self._ending(now_ns)

    def _start_rest(self, now_ns: int) -> None:
        """The second stage, once the recorder listens (or has had long enough to)."""
        late = now_ns - self._started_ns > RECORDER_READY_S * NS_PER_S
        if not self._rest_started and (self.result.monitor.recorder is not None or late):
            self._rest_started = True
            self._supervisor.start(stage=1)

    def _watch_processes(self, now_ns: int) -> None:
        for gone in self._supervisor.poll():
            self._tell(f"{gone}; to start it again: `{gone.again}`" if self._options.stay else str(gone))
            if gone.optional or self._options.stay:
                continue
            self.result.exits.append(gone)
            self._begin_stop(now_ns)
        if self._stop_ns is not None and now_ns - self._stop_ns > OWN_STOP_S * NS_PER_S and not self._asked_to_stop:
            self._asked_to_stop = True  # the gateway drives on without a recorder, but the run is worth nothing
            self._operator.ask(OperatorAction.STOP, now_ns)

    def _watch_gateway(self, now_ns: int) -> None:
        if self._stop_ns is None and self.result.monitor.failsafes and not self._options.stay:
            self._begin_stop(now_ns)
        new, self._told = self.result.monitor.failsafes[self._told :], len(self.result.monitor.failsafes)
        for failsafe in new:
            why = f"{failsafe.cause} ({failsafe.detail})" if failsafe.detail else failsafe.cause
            self._tell(f"gateway: {failsafe.action.replace('_', ' ')}, because {why}")

    def _begin_stop(self, now_ns: int) -> None:
        if self._stop_ns is None:
            self._stop_ns = now_ns

    def _ending(self, now_ns: int) -> Ending | None:
        if self._stopping():
            return self._interrupted(now_ns)
        if self._options.stay:
            return None
        if self._stop_ns is not None:
            return self._stopped(now_ns, self._stop_ns)
        if self._under_way_ns is None:
            return self._given_up(Ending.NEVER_STARTED) if now_ns - self._started_ns > START_S * NS_PER_S else None
        if self._complete(now_ns):
            return Ending.DONE
        return self._given_up(Ending.NOT_MOVING) if self._stuck(now_ns) else None

    def _interrupted(self, now_ns: int) -> Ending | None:
        """The gateway ends first, while there is a car that it can stop; a second signal waits for nothing."""
        if self._interrupted_ns is None:
            self._interrupted_ns = now_ns
            self._supervisor.ask_to_end("gateway")
            if not self.result.referee.standing:
                self._tell("the gateway stops the car and ends; again, and all end at once")
            if others := sorted(self.result.monitor.speaking(now_ns) - set(self._supervisor.pids)):
                self._tell(f"started by hand, and to be ended by hand: {', '.join(others)}")
        waits = "gateway" in self._supervisor.pids and now_ns - self._interrupted_ns < STOP_S * NS_PER_S
        return None if waits and self._stopping.count == 1 else Ending.INTERRUPTED

    def _given_up(self, ending: Ending) -> Ending:
        """The ending, with its cause told."""
        status, plan = self.result.monitor.status, self.result.monitor.plan
        causes = before_arming(status, self._supervisor.pids) if status and status.missing_for_arming else ""
        planned = plan.reason if plan and plan.reason else ""
        self._tell(f"{ending.value}: {causes or planned or 'no process says why'}")
        return ending

    def _complete(self, now_ns: int) -> bool:
        laps = self._options.target_laps
        if laps is not None and self.result.referee.laps >= laps:
            return True
        return self._options.seconds is not None and self._driving_s(now_ns) >= self._options.seconds

    def _stopped(self, now_ns: int, since_ns: int) -> Ending | None:
        """Wait for the car to stand still after something went wrong."""
        waited_s = (now_ns - since_ns) / NS_PER_S
        plant_runs = "plant" in self._supervisor.pids
        if plant_runs and not self.result.referee.standing and waited_s < STOP_S and self._under_way_ns is not None:
            return None
        if self._under_way_ns is not None:
            truth = "the plant is gone" if not plant_runs else f"the car is at {abs(self.result.referee.speed):.1f} m/s"
            self._tell(f"{truth} {waited_s:.1f} s later")
        return Ending.PROCESS_DIED if self.result.exits else Ending.STOPPED

    def _stuck(self, now_ns: int) -> bool:
        if self.result.referee.distance_m > self._distance_m + 1.0:
            self._distance_m, self._moved_ns = self.result.referee.distance_m, now_ns
        since_ns = max(self._moved_ns, self._under_way_ns or 0)
        return now_ns - since_ns > STUCK_S * NS_PER_S

    def _driving_s(self, now_ns: int) -> float:
        return 0.0 if self._under_way_ns is None else (now_ns - self._under_way_ns) / NS_PER_S

    def _tell(self, text: str) -> None:
        self.result.monitor.journal.say(text, self._clock.now_ns())
        self._view.say(text)

    def _scene(self, now_ns: int) -> Scene:
        return Scene(
            now_ns=now_ns,
            elapsed_s=(now_ns - self._started_ns) / NS_PER_S,
            monitor=self.result.monitor,
            referee=self.result.referee,
            cpu_share=self._cpu.share(),
            alive=self._supervisor.pids,
            heading=f"{self._setup.track_name} on {self._setup.bus}",
            ending=self._interrupted_ns is not None,
        )


class CpuMeter:
    """Share of one processor each process has used since `restart`."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._next_ns = 0
        self.restart()

    def restart(self) -> None:
        """Measure from now on."""
        self._base = self._now = self._supervisor.cpu_seconds()
        self._began_s = self._read_s = time.monotonic()

    def update(self, now_ns: int) -> bool:
        """Read the counters, once a second; whether it was done."""
        if now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + CPU_PERIOD_NS
        self._now, self._read_s = self._supervisor.cpu_seconds(), time.monotonic()
        return True

    def share(self) -> dict[str, float]:
        """Processor time over elapsed time, per process."""
        elapsed_s = max(self._read_s - self._began_s, 1e-3)
        return {name: (used - self._base.get(name, 0.0)) / elapsed_s for name, used in self._now.items()}
