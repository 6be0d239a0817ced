"""Faults of the car in the simulated loop: in the frames on their way to the gateway, and in what the actuators get.

The car reports truthfully what its actuators then do.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from benchmarks.faults.car_faults import Alter, CarFault, Memory
from can_dbc.codec import Fault, load_codec
from hil_gateway.can_link import Frame
from hil_gateway.plant.car import Commands
from hil_gateway.plant.events import PunctureEvent
from hil_gateway.plant.plant import Plant
from hil_gateway.process.clock import NS_PER_S
from planner.simulation.loop import Faults

STEER_RAD, BRAKES_PA, THROTTLE = 2e-3, 1e5, 0.05
"""what an actuator that works may be away from its command: play of the steering (1.7 deg at the motor), the pressure
at which brakes begin to bite, play of the pedal"""


class Injected:
    """One fault from when it began."""

    def __init__(self, fault: CarFault, start_ns: int, seed: int) -> None:
        self.fault, self._start_ns, self._rng = fault, start_ns, random.Random(seed)
        self._codec = load_codec()
        self._memory: dict[str, Memory] = {}
        self._held: list[tuple[int, Frame]] = []

    def frames(self, now_ns: int, frames: list[Frame]) -> list[Frame]:
        """What becomes of `frames`, after those that were held back until now."""
        out = [frame for due, frame in self._held if due <= now_ns]
        self._held = [entry for entry in self._held if entry[0] > now_ns]
        for frame in frames:
            out += self._through(frame, now_ns)
        return out

    def _through(self, frame: Frame, now_ns: int) -> list[Frame]:
        fault, layout = self.fault, self._codec.by_id.get(frame.id)
        if layout is None or layout.name not in fault.messages:
            return [frame]
        if fault.delay_s:
            due_ns = now_ns + int(fault.delay_s * NS_PER_S)
            self._held.append((due_ns, replace(frame, stamp_ns=frame.stamp_ns + due_ns - now_ns)))
            return []
        if fault.twice is not None:
            other = self._altered(layout.name, frame, fault.twice, now_ns)
            return [frame, *other, *other]
        return [frame] if fault.alter is None else self._altered(layout.name, frame, fault.alter, now_ns)

    def _altered(self, name: str, frame: Frame, alter: Alter, now_ns: int) -> list[Frame]:
        memory = self._memory.setdefault(name, Memory(self._rng))
        memory.t = (now_ns - self._start_ns) / NS_PER_S
        values = self._codec.decode(frame.id, frame.data)
        changed = None if isinstance(values, Fault) else alter(values, memory)
        if changed is None or isinstance(values, Fault):
            return []
        counter = self._codec.by_id[frame.id].counter
        alive: Mapping[str, float] = {counter.signal: values[counter.signal]} if counter else {}
        return [replace(frame, data=self._codec.encode(name, {**changed, **alive})[1])]


class SimulatedFault(Faults):
    """Faults that have begun, in order; nothing before the first."""

    def __init__(self) -> None:
        self._injected: list[Injected] = []
        self.shows = False
        """whether a fault has had an effect: what is reported is changed from the first moment on, an actuator may have
        done what it was asked for"""

    def begin(self, fault: CarFault, plant: Plant, now_ns: int, seed: int) -> None:
        """From now on."""
        self._injected.append(Injected(fault, now_ns, seed))
        if fault.actuate is not None:
            self._break_actuators(plant, fault.actuate)
        if fault.flat:
            plant.car.happens(PunctureEvent(kind="puncture", t=0.0, wheel=fault.flat))
        self.shows = self.shows or fault.actuate is None

    def frames(self, now_ns: int, receiver: str, frames: list[Frame]) -> list[Frame]:
        if receiver == "gateway":
            for injected in self._injected:
                frames = injected.frames(now_ns, frames)
        return frames

    def _break_actuators(self, plant: Any, actuate: Callable[[Commands, Commands], Commands]) -> None:
        """Put an actuator fault between the vehicle controller and the car."""
        obeyed, did = plant.controller.obeyed, list[Commands]()

        def broken(t_ns: int, received: Any) -> Commands:
            asked = obeyed(t_ns, received)
            did[:] = [actuate(asked, did[0] if did else asked)]
            self.shows = self.shows or _differ(asked, did[0])
            return did[0]

        plant.controller.obeyed = broken


def _differ(asked: Commands, did: Commands) -> bool:
    """Whether an actuator does clearly something else."""
    brakes = abs(asked.brake_front - did.brake_front) + abs(asked.brake_rear - did.brake_rear)
    throttle, steer = abs(asked.throttle - did.throttle), abs(asked.steer - did.steer)
    return brakes > BRAKES_PA or throttle > THROTTLE or steer > STEER_RAD
