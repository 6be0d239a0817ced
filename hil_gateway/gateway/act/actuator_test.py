"""Actuator test of the bring-up: one small, slow move after the other, engine off, car standing.

Each move rises to its peak, holds, falls and rests, a second each. What to see: the reports follow
(`hil gateway check`), steering to the left first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hil_gateway.car.actuation import PRESSED, ActuatorPositions

PHASE_S = 1.0
"""to rise, to hold, to fall and to rest: slow enough to be seen"""


@dataclass(frozen=True, slots=True)
class Move:
    """One actuator to `peak` and back."""

    actuator: str
    peak: float
    """Pa, share of the accelerator, or share of the range of the steering"""


MOVES: tuple[Move, ...] = (
    Move("steering_motor", 0.125),
    Move("steering_motor", -0.125),
    Move("brake_front", 5.0 * PRESSED),
    Move("brake_rear", 5.0 * PRESSED),
    Move("accelerator", 0.05),
)


def position(elapsed_s: float, steering_range: float) -> ActuatorPositions:
    """Where the actuators are to be so long after the start; at rest before, between and after the moves.

    `steering_range` of the motor to either side, rad.
    """
    rest = ActuatorPositions(0.0, 0.0, 0.0, 0.0, 0)
    index, phases = divmod(elapsed_s / PHASE_S, 4)
    if not 0 <= index < len(MOVES):
        return rest
    move = MOVES[int(index)]
    value = max(0.0, min(phases, 1.0, 3.0 - phases)) * move.peak
    value *= steering_range if move.actuator == "steering_motor" else 1.0
    changed: dict[str, Any] = {move.actuator: value}
    return rest._replace(**changed)
