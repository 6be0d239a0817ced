"""The whole loop as real processes, with a person, a judge on the wire and a referee."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.promises.wire_judge import DLC, Judge
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LatestReader
from hil_gateway.bus.messages import FailsafeAction, OperatorAction, OperatorCommand
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.can_link import open_link
from hil_gateway.demo.options import DemoOptions, prepare
from hil_gateway.demo.referee import DriveReferee
from hil_gateway.process.supervisor import DASHBOARD, PROCESSES, ProcessSpec, Supervisor

STOPS = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)
UP_S = 180.0
WAYS = ("kill", "stop", "starve")
SILENCE_NS = 200_000_000
"""after which the car has noticed that commands ended: what follows begins anew, at the angle that the car reports"""


class Ordinary(Supervisor):
    """Processes without permission to go before others: no real-time priority, no negative niceness."""

    def command(self, spec: ProcessSpec) -> list[str]:
        return ["setpriv", "--bounding-set=-sys_nice", "nice", "-n", "10", *super().command(spec)]


class LiveLoop:
    """The supervised processes with a person, a judge on the wire and a referee who sees the car's truth."""

    def __init__(self, folder: Path, real_time: bool = True, track: str = "") -> None:
        setup = prepare(DemoOptions(seconds=3600.0, out=folder, headless=True, track=track))
        self.lock, self.config = setup.lock, setup.config
        self.specs = {spec.name: spec for spec in (*PROCESSES, DASHBOARD)}
        kind = Supervisor if real_time else Ordinary
        self.supervisors = {name: kind(setup.config_file, folder, (spec,)) for name, spec in self.specs.items()}
        self.folder = folder
        self.judge = Judge()
        self.gaps: list[float] = []
        self._last_ns: int | None = None
        self._heard_ns = 0
        self.seq = 0
        self._ended: list[str] = []
        """beside what was taken away"""
        self.done: list[str] = []
        """losses so far"""

    def __enter__(self) -> LiveLoop:
        self.link = open_link(self.config.can)
        for stage in sorted({spec.stage for spec in self.specs.values()}):
            for supervisor in self.supervisors.values():
                supervisor.start(stage)
            time.sleep(1.0)
        self.bus = open_bus(self.config.zenoh, "operator")
        self.status = LatestReader(self.bus, topics.GATEWAY_STATUS)
        self.state = LatestReader(self.bus, topics.VEHICLE_STATE)
        self.referee = DriveReferee(self.bus)
        return self

    def __exit__(self, *_: object) -> None:
        for name, supervisor in self.supervisors.items():
            if name in supervisor.pids:
                os.kill(supervisor.pids[name], signal.SIGCONT)
            supervisor.stop()
        self.bus.close()
        self.link.close()
        self.lock.release()

    def start(self, name: str) -> None:
        """Start one process, perhaps again."""
        self.supervisors[name].start(self.specs[name].stage)

    def start_missing(self) -> None:
        """Start again what ended by itself, as systemd would."""
        for name, supervisor in self.supervisors.items():
            if name not in supervisor.pids:
                self.start(name)

    def bring_back(self) -> None:
        """The car stands where it began, ignition off and on: a crane."""
        self.lose("plant", "kill", 0.0)

    def pid(self, name: str) -> int:
        return self.supervisors[name].pids[name]

    def memory_mb(self) -> dict[str, float]:
        """Resident memory of every process that runs, MB, from proc(5) statm."""
        page_mb = os.sysconf("SC_PAGE_SIZE") / 1e6
        pids = {name: pid for supervisor in self.supervisors.values() for name, pid in supervisor.pids.items()}
        return {n: int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * page_mb for n, pid in pids.items()}

    def died(self) -> list[str]:
        """Processes that ended by themselves since the last call."""
        found, self._ended = [*self._ended, *self._poll()], []
        return found

    def _poll(self) -> list[str]:
        return [str(end) for supervisor in self.supervisors.values() for end in supervisor.poll()]

    def look(self, seconds: float = 0.0) -> None:
        """Listen to wire and bus for a while."""
        deadline = time.monotonic() + seconds
        while True:
            for frame in self.link.receive(0.01):
                if frame.id in DLC:
                    if frame.stamp_ns - self._heard_ns > SILENCE_NS:
                        self.judge.last.clear()
                        self._last_ns = None
                    self._heard_ns = frame.stamp_ns
                    self.judge.take(frame.id, frame.data)
                if frame.id == 0x57A:
                    if self._last_ns is not None:
                        self.gaps.append((frame.stamp_ns - self._last_ns) / 1e9)
                    self._last_ns = frame.stamp_ns
            now_ns = time.monotonic_ns()
            self.status.update(now_ns)
            self.state.update(now_ns)
            self.referee.update(now_ns)
            if time.monotonic() >= deadline:
                return

    @property
    def action(self) -> FailsafeAction | None:
        """State of the gateway that speaks; None: none does."""
        message = self.status.latest.message
        return message.action if message is not None and self.status.latest.alive(time.monotonic_ns()) else None

    @property
    def cause(self) -> str:
        """Why the gateway is in its state."""
        message = self.status.latest.message
        return "" if message is None else message.cause

    @property
    def speed(self) -> float:
        message = self.state.latest.message
        return 0.0 if message is None else message.wheel_speed_rl

    def ask(self, action: OperatorAction) -> None:
        self.seq += 1
        message = OperatorCommand(stamp_ns=time.monotonic_ns(), seq=self.seq, source="test", action=action)
        self.bus.publish(topics.OPERATOR, message)

    def drive_off(self) -> None:
        """Whatever it takes to drive: stand, disarm, crank, arm."""
        assert self.drives_off(UP_S), f"{self.done}: {self.missing}"

    def drives_off(self, within_s: float) -> bool:
        """`drive_off`, and whether the car drives within that time."""
        deadline = time.monotonic() + within_s
        while self.action is not FailsafeAction.DRIVE or self.speed < 5.0:
            if time.monotonic() > deadline:
                return False
            self.look(0.2)
            message = self.status.latest.message
            if message is None or self.action in {None, FailsafeAction.DRIVE}:
                continue
            if not message.missing_for_crank:
                self.ask(OperatorAction.CRANK)
            # the car may have gone into its own emergency after the first disarming: then it takes a second one
            if (self.action in STOPS or "car_emergency" in message.missing_for_arming) and self.speed < 0.3:
                self.ask(OperatorAction.DISARM)
            elif self.action is FailsafeAction.SILENT and not message.missing_for_arming:
                self.ask(OperatorAction.ARM)
        return True

    @property
    def missing(self) -> str:
        """What keeps the gateway from being armed; empty: nothing."""
        message = self.status.latest.message
        return "no status" if message is None else ", ".join(message.missing_for_arming)

    def lose(self, victim: str, way: str, length_s: float) -> None:
        """Take a process away by one of `WAYS`, look on, and give it back."""
        self.done.append(f"{victim} {way}")
        if way == "kill":
            os.kill(self.pid(victim), signal.SIGKILL)
            self.look(1.5)
            self._ended += [end for end in self._poll() if not end.startswith(f"{victim} ")]
            self.start(victim)
        else:
            self.freeze([self.pid(victim)], length_s, 0.5 if way == "starve" else length_s)
            self.look(0.3)

    def freeze(self, pids: Sequence[int], length_s: float, slice_s: float) -> None:
        """Stop processes for a while; after each slice they get one millisecond of work."""
        deadline = time.monotonic() + length_s
        while time.monotonic() < deadline:
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            self.look(slice_s)
            for pid in pids:
                os.kill(pid, signal.SIGCONT)
            self.look(0.001)
