"""When a drive command carries the standing car: the brakes hold it until then."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.road_speed import STANDSTILL, road_speed
from hil_gateway.settings.gateway import PERIOD_S


class HillStart:
    """Learns what gravity takes from the accelerometer of a car that its brakes hold; one `holds` a period."""

    def __init__(self, pressure: float, forward: float) -> None:
        """`pressure` that holds the car, Pa; `forward`: what a command gives beyond what gravity takes, m/s2."""
        self._pressure, self._forward = pressure, forward
        self._uphill = 0.0
        """specific force along the standing car, m/s2: what gravity takes, positive uphill"""

    def watch(self, state: VehicleState, on_wire: ActuatorPositions) -> None:
        """Once a period, before it is asked."""
        braked = min(on_wire.brake_front, on_wire.brake_rear) >= self._pressure
        if braked and state.valid and road_speed(state) < STANDSTILL:  # by then it rocks no longer after a stop
            self._uphill += PERIOD_S / (UNSEEN_S + PERIOD_S) * (state.ax - self._uphill)

    def holds(self, state: VehicleState, acceleration: float) -> bool:
        """Whether a standing car is held under a command that gives it `acceleration` on the level, m/s2."""
        return road_speed(state) < STANDSTILL and acceleration < self._uphill + self._forward
