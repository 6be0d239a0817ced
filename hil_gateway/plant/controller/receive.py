"""Command frames to what the vehicle controller has received."""

from __future__ import annotations

from collections.abc import Iterable

from can_dbc.codec import COUNTER, Fault
from hil_gateway.can_link import Frame
from hil_gateway.car.car import Car
from hil_gateway.car.states import computer_codes
from hil_gateway.plant.car import Commands
from hil_gateway.plant.controller.ladder import ReceivedCommand


class CommandReceiver:
    """Keeps the newest commands and when their counters advanced, or when they came where they have none."""

    def __init__(self, platform: Car) -> None:
        """`platform`: whose frames it reads, and the ratios between its commands and the wheels."""
        self._codec = codec = platform.codec
        self._layouts = {m.id: m for m in codec.messages.values() if m.direction == "computer"}
        self._ratio, self._bias = platform.vehicle.steering_ratio, platform.powertrain.brake_bias_front
        codes = computer_codes(codec.signals.codes["ct_state"])
        self._states = {code: state for state, code in codes.items()}  # of rungs that share a code the highest
        actuators = codec.signals.actuator_messages
        counted = [name for name in actuators if codec.messages[name].counter is not None]
        self._supervised = tuple(counted or actuators)
        self._counters: dict[str, float] = {}
        self._advanced_ns: dict[str, int] = {}
        self._values: dict[str, float] = {}
        self.received = ReceivedCommand()

    def take(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Take in frames, oldest first; what cannot be decoded or comes from the car itself says nothing."""
        changed = False
        for frame in frames:
            layout = self._layouts.get(frame.id)
            if frame.is_error or layout is None:
                continue
            values = self._codec.decode_quantities(frame.id, frame.data)
            if isinstance(values, Fault):
                continue
            self._values.update(values)
            changed = True
            if layout.name in self._supervised:
                self._count(layout.name, values.get(COUNTER), now_ns)
        if changed:
            self._update()

    def forget(self) -> None:
        """Start anew (after an emergency has been left): old commands are neither supervised nor obeyed again."""
        self._advanced_ns.clear()
        self._counters.clear()
        self._values = {"ct_state": self._values.get("ct_state", 0.0)}
        self._update()

    def _count(self, name: str, counter: float | None, now_ns: int) -> None:
        if not self._advanced_ns:
            self._advanced_ns = dict.fromkeys(self._supervised, now_ns)
        if counter is None or counter != self._counters.get(name):
            self._counters[name] = counter or 0.0
            self._advanced_ns[name] = now_ns

    def _update(self) -> None:
        value = self._values.get
        front = value("brake_front", 0.0)
        self.received.ct_state = self._states.get(int(value("ct_state", 0)), 0)
        self.received.commands = Commands(
            steer=value("steering_motor", 0.0) / self._ratio,
            throttle=min(max(value("accelerator", 0.0), 0.0), 1.0),
            brake_front=front,
            brake_rear=value("brake_rear", front * (1.0 - self._bias) / self._bias),
            gear=int(value("gear", 0)),
        )
        self.received.counters_ns = tuple(self._advanced_ns.values()) if self._advanced_ns else None
