"""Command frames to what the vehicle controller has received."""

from __future__ import annotations

from collections.abc import Iterable

from can_dbc.codec import Codec, Fault
from hil_gateway.can_link import Frame
from hil_gateway.plant.car import Commands
from hil_gateway.plant.controller.ladder import Received

COUNTERS = {
    "steering_cmd": "steering_motor_cmd_counter",
    "accelerator_cmd": "acc_pedal_cmd_counter",
    "brake_pressure_cmd": "brk_pressure_cmd_counter",
}


class CommandReceiver:
    """Keeps the newest commands and when their counters advanced."""

    def __init__(self, codec: Codec, steering_ratio: float) -> None:
        self._codec = codec
        self._layouts = {m.id: m for m in codec.messages.values() if m.direction == "computer"}
        self._ratio = steering_ratio
        self._counters: dict[str, int] = {}
        self._advanced_ns: dict[str, int] = {}
        self._values: dict[str, float] = {}
        self.received = Received()

    def take(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Take in frames, oldest first; what cannot be decoded or comes from the car itself says nothing."""
        changed = False
        for frame in frames:
            layout = self._layouts.get(frame.id)
            if frame.is_error or layout is None:
                continue
            values = self._codec.decode(frame.id, frame.data)
            if isinstance(values, Fault):
                continue
            self._values.update(values)
            changed = True
            if layout.name in COUNTERS:
                self._count(layout.name, int(values[COUNTERS[layout.name]]), now_ns)
        if changed:
            self._update()

    def forget(self) -> None:
        """Start anew (after an emergency has been left): old commands are neither supervised nor obeyed again."""
        self._advanced_ns.clear()
        self._counters.clear()
        self._values = {"ct_state": self._values.get("ct_state", 0.0)}
        self._update()

    def _count(self, name: str, counter: int, now_ns: int) -> None:
        if not self._advanced_ns:
            self._advanced_ns = dict.fromkeys(COUNTERS, now_ns)
        if counter != self._counters.get(name):
            self._counters[name] = counter
            self._advanced_ns[name] = now_ns

    def _update(self) -> None:
        value = self._values.get
        self.received.ct_state = int(value("ct_state", 0))
        self.received.commands = Commands(
            steer=value("steering_motor_ang_cmd", 0.0) / self._ratio,
            throttle=min(max(value("acc_pedal_cmd", 0.0), 0.0), 1.0),
            brake_front=value("F_brake_pressure_cmd", 0.0),
            brake_rear=value("R_brake_pressure_cmd", 0.0),
            gear=int(value("desired_gear", 0)),
        )
        self.received.counters_ns = tuple(self._advanced_ns.values()) if self._advanced_ns else None
