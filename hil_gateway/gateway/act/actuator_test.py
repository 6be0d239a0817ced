"""Actuator test of the bring-up: one small, slow move after the other, engine off, car standing.

Each move rises to its peak in a second, holds for one, falls in one; a pause between them. What to see: the reports
follow (`hil gateway check`), steering to the left first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from hil_gateway.car.actuation import ActuatorPositions

RAMP_S = 1.0
PAUSE_S = 1.0
MOVE_S = 3 * RAMP_S + PAUSE_S


@dataclass(frozen=True, slots=True)
class Move:
    """One actuator to `peak` (SI) and back."""

    actuator: str
    peak: float


MOVES: tuple[Move, ...] = (
    Move("steering_motor", math.radians(30.0)),
    Move("steering_motor", math.radians(-30.0)),
    Move("brake_front", 500e3),
    Move("brake_rear", 500e3),
    Move("accelerator", 0.05),
)
DURATION_S = len(MOVES) * MOVE_S


def position(elapsed_s: float) -> ActuatorPositions:
    """Where the actuators are to be so long after the start; at rest before, between and after the moves."""
    rest = ActuatorPositions(0.0, 0.0, 0.0, 0.0, 0)
    index, within_s = divmod(elapsed_s, MOVE_S)
    if not 0 <= index < len(MOVES):
        return rest
    move = MOVES[int(index)]
    value = max(0.0, min(within_s / RAMP_S, 1.0, 3.0 - within_s / RAMP_S)) * move.peak
    changed: dict[str, Any] = {move.actuator: value}
    return rest._replace(**changed)
