"""Single faults of the car from many places at speed: noticed, when, and whether the stop keeps to the road."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.config import Config
from hil_gateway.plant.car_file import SimulatedCar
from planner.simulation.loop import Loop
from verification.fault_simulation.car_faults import CAR_FAULTS, CarFault, SimulatedFault

WATCHED_S = 8.0
"""without a stop for so long the fault has done no harm here"""
STANDS_WITHIN_S = 25.0


@dataclass(frozen=True)
class FaultResult:
    """What one fault came to."""

    fault: str
    at_s: float
    speed: float
    noticed_s: float | None
    cause: str
    stands: bool
    margin_m: float
    """least distance of a wheel to the edge from the fault on, by the referee; negative: off the road"""
    margin_unnoticed_m: float
    """the same until the stop began"""

    @property
    def harmful(self) -> bool:
        """Off the road with nobody having noticed."""
        return self.noticed_s is None and self.margin_m < 0.0


def simulate(loop: Loop, injector: SimulatedFault, fault: CarFault, seed: int) -> FaultResult:
    """From the loop's present state until the car stands, or nothing has happened for `WATCHED_S`."""
    referee, begin_s, speed = loop.plant.referee, loop.elapsed_s, loop.plant.car["vx"]
    referee.worst_margin_m = math.inf
    injector.begin(fault, loop.clock.now_ns(), seed)
    injector.break_actuators(loop.plant)
    noticed_s, before = None, math.inf
    while loop.elapsed_s < begin_s + STANDS_WITHIN_S and not loop.plant.car.standing:
        loop.step()
        if noticed_s is None and loop.gateway.failsafe.action is not FailsafeAction.DRIVE:
            noticed_s, before = loop.elapsed_s - begin_s, referee.worst_margin_m
        if noticed_s is None and loop.elapsed_s > begin_s + WATCHED_S:
            break
    standing, cause = bool(loop.plant.car.standing), loop.gateway.failsafe.cause
    return FaultResult(fault.name, begin_s, speed, noticed_s, cause, standing, referee.worst_margin_m, before)


def campaign(  # noqa: PLR0917 - what a campaign is
    track: str, points: int, spacing_s: float, faults: Sequence[CarFault] = CAR_FAULTS, car: SimulatedCar | None = None,
    first_s: float = 14.0,
) -> Iterator[FaultResult]:  # fmt: skip
    """Every fault from every point, each in a forked copy of the running loop."""
    injector = SimulatedFault()
    config = Config.model_validate({"track": track, "planner": {"horizon": 20}, "estimator": {"learn": False}})
    loop = Loop(config, faults=injector, simulated=car)
    for point in range(points):
        until_s = first_s + point * spacing_s
        while loop.elapsed_s < until_s:
            loop.step()
        for number, fault in enumerate(faults):
            yield FaultResult(**_in_a_copy(loop, injector, fault, 1000 * point + number))


def _in_a_copy(loop: Loop, injector: SimulatedFault, fault: CarFault, seed: int) -> dict[str, Any]:
    reader, writer = os.pipe()
    if not (pid := os.fork()):
        status = 1
        try:
            os.write(writer, json.dumps(asdict(simulate(loop, injector, fault, seed))).encode())
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        text = pipe.read()
    os.waitpid(pid, 0)
    if not text:
        raise RuntimeError(f"the copy that simulated {fault.name!r} died")
    content: dict[str, Any] = json.loads(text)
    return content
