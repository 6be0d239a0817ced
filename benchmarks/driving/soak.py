"""A long drive in which everything is lost in turn: processes, the computer's sleep, its clock, its disk.

Real processes and the simulated car; a lost process is started again, as systemd would, and no other is. Kept is a loss
after which the car does what `docs/failsafe.md` says, stays on the road, and drives again within `AGAIN_S`. Where the
gateway itself is gone the car stops by its own brakes: whether it stays on the road then is reported, not judged.
"""

from __future__ import annotations

import random
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.driving.live_loop import WAYS, LiveLoop
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.process.processor_wait import TIMING_CAUSES

AGAIN_S = 60.0
"""from the end of a loss until the car drives again; a planner started anew compiles nothing"""
SLEEP_S, CLOCK_STEP_S, SMALL_DISK = 5.0, 30.0, 2e9
PHASES = {"standing": (0.0, 0.0), "setting off": (0.0, 3.0), "driving": (3.0, 40.0)}
"""seconds of driving before a loss"""
STANDING_MPS = 0.3


@dataclass(frozen=True)
class Loss:
    """Something that is lost while the car drives, and given back.

    Attributes:
        stops: whether the car has to stop; own_brakes: by its own brakes, because the gateway is gone.
    """

    name: str
    happen: Callable[[LiveLoop, random.Random], None]
    stops: bool
    own_brakes: bool = False


@dataclass(frozen=True)
class Outcome:
    """What became of a loss. `again_s`: seconds until the car drove again; None: it did not."""

    loss: str
    phase: str
    speed: float
    action: str
    cause: str
    left_the_road: bool
    died: tuple[str, ...]
    illegal: tuple[str, ...]
    again_s: float | None
    broken: str

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        again = "does not drive again" if self.again_s is None else f"drives again after {self.again_s:.1f} s"
        ended = f"{self.action}{f' ({self.cause})' if self.cause else ''}, {again}"
        return f"{self.loss} {self.phase}, {self.speed:.1f} m/s: {ended}{f': {self.broken}' if self.broken else ''}"


def losses(folder: Path, step_clock: bool) -> list[Loss]:
    """What can be lost here: the clock where it is allowed, the disk where it is small enough to be filled."""
    stop = {"gateway": True, "planner": True, "estimator": True, "recorder": False, "dashboard": False}
    found = [_of_process(name, way, stops) for name, stops in stop.items() for way in WAYS]
    found.append(Loss("computer asleep", _sleep, stops=True))
    if step_clock:
        found.append(Loss("clock stepped", _step_clock, stops=False))
    if shutil.disk_usage(folder).total < SMALL_DISK:
        found.append(Loss("disk full", _fill_disk, stops=False))
    return found


def _of_process(name: str, way: str, stops: bool) -> Loss:
    def happen(loop: LiveLoop, rng: random.Random) -> None:
        loop.lose(name, way, rng.uniform(0.7, 5.0))

    return Loss(f"{name} {way}", happen, stops, own_brakes=name == "gateway")


def _sleep(loop: LiveLoop, _: random.Random) -> None:
    """The computer sleeps, and the simulated car with it."""
    loop.freeze([loop.pid(name) for name in loop.specs], SLEEP_S, SLEEP_S)
    loop.look(1.0)


def _step_clock(loop: LiveLoop, rng: random.Random) -> None:
    """The computer's clock is set; `time.monotonic` goes on."""
    step_s = rng.choice((-1.0, 1.0)) * CLOCK_STEP_S
    for change_s in (step_s, -step_s):
        time.clock_settime(time.CLOCK_REALTIME, time.time() + change_s)
        loop.look(2.0)


def _fill_disk(loop: LiveLoop, _: random.Random) -> None:
    filler, block = loop.folder / "filler", bytes(1 << 20)
    with suppress(OSError), filler.open("wb", buffering=0) as file:  # until there is no space left
        while file.write(block):
            pass
    loop.look(3.0)
    filler.unlink()
    loop.look(1.0)


def soak(loop: LiveLoop, seconds: float, seed: int, step_clock: bool = False) -> Iterator[Outcome]:
    """Losses dealt by the seed, until the time is over or the car cannot be driven any more."""
    rng, deadline = random.Random(seed), time.monotonic() + seconds
    table = losses(loop.folder, step_clock)
    while time.monotonic() < deadline:
        for loss in rng.sample(table, len(table)):
            phase = rng.choice(tuple(PHASES))
            outcome = trial(loop, loss, phase, rng)
            yield outcome
            if outcome.again_s is None or time.monotonic() > deadline:
                return


def trial(loop: LiveLoop, loss: Loss, phase: str, rng: random.Random) -> Outcome:
    """One loss in a phase, to the end."""
    _reach(loop, phase, rng)
    left, speed, drove = loop.referee.off_track, loop.referee.speed, loop.action is FailsafeAction.DRIVE
    loop.judge.faults.clear()
    loss.happen(loop, rng)
    action, cause, died = loop.action, loop.cause, tuple(loop.died())
    _await_end(loop)
    left_the_road = loop.referee.off_track > left
    loop.start_missing()
    if left_the_road:
        loop.bring_back()
    begin = time.monotonic()
    again = loop.drives_off(AGAIN_S)
    outcome = Outcome(
        loss.name, phase, speed, "gone" if action is None else action.value, cause, left_the_road, died,
        tuple(loop.judge.faults[:3]), time.monotonic() - begin if again else None, "",
    )  # fmt: skip
    return Outcome(**{**asdict(outcome), "broken": _broken(outcome, loss, drove, loop)})


def _reach(loop: LiveLoop, phase: str, rng: random.Random) -> None:
    if phase == "standing":
        loop.ask(OperatorAction.STOP)
        loop.look(0.2)
        _await_end(loop)
    else:
        loop.look(rng.uniform(*PHASES[phase]))


def _await_end(loop: LiveLoop) -> None:
    """Until the car stands, or drives on by commands."""
    deadline = time.monotonic() + AGAIN_S
    while loop.action is not FailsafeAction.DRIVE and abs(loop.referee.speed) > STANDING_MPS:
        if time.monotonic() > deadline:
            return
        loop.look(0.2)


def _broken(outcome: Outcome, loss: Loss, drove: bool, loop: LiveLoop) -> str:
    """What is not as it should be; empty: all is."""
    late = outcome.cause in TIMING_CAUSES and not loss.stops
    if outcome.died:
        return f"died with it: {', '.join(outcome.died)}"
    if outcome.illegal:
        return f"illegal on the wire: {outcome.illegal[0]}"
    if outcome.again_s is None:
        return f"missing for arming: {loop.missing or 'nothing'}"
    if outcome.left_the_road and not loss.own_brakes:
        return "left the road"
    stopped = outcome.action != FailsafeAction.DRIVE.value
    if drove and stopped != loss.stops and not late:
        return f"{'stops' if stopped else 'drives on'}, against docs/failsafe.md"
    return ""
