"""How fast the car goes by its wheels, and below what it stands."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState

STANDSTILL = 0.5
"""m/s"""
AT_REST = 0.02
"""m/s: below the resolution of the wheel speeds, 0.1 km/h"""


def road_speed(state: VehicleState) -> float:
    """Fastest wheel, m/s: a locked wheel must not pass for standstill."""
    return max(state.wheel_speed_fl, state.wheel_speed_fr, state.wheel_speed_rl, state.wheel_speed_rr)


def rests(state: VehicleState) -> bool:
    """Whether all wheels stand still."""
    return road_speed(state) < AT_REST
