"""How fast the car goes by its wheels, and below what it stands."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.vehicle import Vehicle

Wheels = tuple[float, float, float, float]
"""front left, front right, rear left, rear right, m/s"""

STANDSTILL = 0.5
"""m/s"""
AT_REST = 0.02
"""m/s: below the resolution of the wheel speeds, 0.1 km/h"""


def road_speed(state: VehicleState) -> float:
    """Fastest wheel, m/s: a locked wheel must not pass for standstill."""
    return max(wheel_speeds(state))


def wheel_speeds(state: VehicleState) -> Wheels:
    """As they are reported."""
    return state.wheel_speed_fl, state.wheel_speed_fr, state.wheel_speed_rl, state.wheel_speed_rr


def at_the_middle(state: VehicleState, car: Vehicle, yaw_rate: float) -> Wheels:
    """What they say of the middle of their axles: in a bend outer wheels go further."""
    front, rear = 0.5 * car.track_front * yaw_rate, 0.5 * car.track_rear * yaw_rate
    fl, fr, rl, rr = wheel_speeds(state)
    return fl + front, fr - front, rl + rear, rr - rear


def rests(state: VehicleState) -> bool:
    """Whether all wheels stand still."""
    return road_speed(state) < AT_REST
