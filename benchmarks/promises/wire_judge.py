"""Judges the bytes that left by an independent decoder (cantools) and by limits written down here a second time.

Nothing of the gateway's chain is imported: a mistake there must not excuse itself here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from can_dbc.folder import SHIPPED

VALUES = {
    "steering_motor_ang_cmd": (-239.8, 239.8),
    "acc_pedal_cmd": (0.0, 100.0),
    "F_brake_pressure_cmd": (0.0, 6000.0),
    "R_brake_pressure_cmd": (0.0, 6000.0),
    "desired_gear": (0.0, 6.0),
}
STEPS = {
    "steering_motor_ang_cmd": (5.0, 5.0),  # 500 deg/s
    "acc_pedal_cmd": (4.0, 100.0),  # 400 %/s up, free down
    "F_brake_pressure_cmd": (1800.0, 600.0),  # 180,000 kPa/s up, 60,000 down
    "R_brake_pressure_cmd": (1800.0, 600.0),
    "desired_gear": (1.0, 1.0),
}
"""Largest rise and fall from frame to frame."""
COUNTERS = {
    "steering_cmd": "steering_motor_cmd_counter",
    "accelerator_cmd": "acc_pedal_cmd_counter",
    "brake_pressure_cmd": "brk_pressure_cmd_counter",
}
DLC = {0x578: 8, 0x579: 8, 0x57A: 8, 0x57B: 8, 0x57C: 8, 0x57D: 8}


@cache
def _decoder() -> Any:
    import cantools

    return cantools.database.load_file(SHIPPED / "av24/av24.dbc").decode_message


def other_than_brakes(frames: Iterable[tuple[int, bytes]]) -> list[str]:
    """What frames (identifier, data) ask for beside brakes: the accelerator, or steering that moves."""
    found, steering = [], None
    for frame_id, data in frames:
        signals = _decoder()(frame_id, data, decode_choices=False)
        if signals.get("acc_pedal_cmd", 0.0) > 0:
            found.append(f"accelerator {signals['acc_pedal_cmd']} %")
        angle = signals.get("steering_motor_ang_cmd", steering)
        if steering is not None and angle != steering:
            found.append(f"steering from {steering} to {angle} deg")
        steering = angle
    return found


@dataclass
class Judge:
    """Takes frames in order; `faults` says what was wrong, if anything."""

    decode: Any = field(default_factory=_decoder)
    last: dict[str, float] = field(default_factory=dict)
    frames: int = 0
    faults: list[str] = field(default_factory=list)

    def take(self, frame_id: int, data: bytes) -> None:
        """Judge one frame."""
        self.frames += 1
        if DLC.get(frame_id) != len(data):
            self.faults.append(f"frame {frame_id:#x} with {len(data)} bytes is not declared")
            return
        signals = self.decode(frame_id, data, decode_choices=False)
        for name, value in signals.items():
            if name in VALUES:
                self._judge(name, float(value))
            elif name in COUNTERS.values():
                self._count(name, int(value))
            self.last[name] = float(value)
        brakes = max(self.last.get("F_brake_pressure_cmd", 0.0), self.last.get("R_brake_pressure_cmd", 0.0))
        if frame_id == 0x579 and brakes > 50.0 and self.last["acc_pedal_cmd"] > 0:
            self.faults.append(f"accelerator {self.last['acc_pedal_cmd']} % with brakes at {brakes} kPa")

    def _judge(self, name: str, value: float) -> None:
        low, high = VALUES[name]
        rise, fall = STEPS[name]
        before = self.last.get(name, value)
        if not low <= value <= high:
            self.faults.append(f"{name} {value} outside {low}..{high}")
        if not -fall - 1e-6 <= value - before <= rise + 1e-6:
            self.faults.append(f"{name} steps from {before} to {value}")

    def _count(self, name: str, value: int) -> None:
        before = self.last.get(name)
        if before is not None and value != (before + 1) % 256:
            self.faults.append(f"{name} steps from {before:.0f} to {value}")
