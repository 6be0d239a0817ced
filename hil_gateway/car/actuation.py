"""Between what the planner asks for (road-wheel angle, slip-ratio drive d) and what the car's actuators take.

Force wanted: F = C_x d with the declared C_x (Eq. 2). Positive F: accelerator = F over the full-throttle force in
the gear; negative F: brake pressures p_f, p_r = (1 + b) / 2 F / k, (1 - b) / 2 F / k with the balance b. The inverse
turns reported pedals into the equivalent d, which is what the estimator learns from.
"""

from __future__ import annotations

from typing import NamedTuple

from hil_gateway.car.powertrain import Powertrain
from hil_gateway.car.vehicle import Vehicle

PRESSED = 1.0e5
"""Pa: with less, hydraulic brakes do nothing: springs, seals; and the noise of their sensors has no balance"""


def brake_balance(front: float, rear: float) -> float:
    """Difference of front and rear pressure (Pa) over their sum, -1..1; fades to 0 below `PRESSED`."""
    return (front - rear) / max(front + rear, PRESSED)


class ActuatorPositions(NamedTuple):
    """One set of actuator positions, SI: motor angle (rad), pedal (0..1), pressures (Pa), gear (0 neutral)."""

    steering_motor: float
    accelerator: float
    brake_front: float
    brake_rear: float
    gear: int


class Actuation:
    """The declared conversion, both ways."""

    def __init__(self, vehicle: Vehicle, powertrain: Powertrain) -> None:
        self._vehicle = vehicle
        self._powertrain = powertrain

    def to_actuators(  # noqa: PLR0917 - a command and the state of the car
        self, steer: float, drive: float, gear: int, engine_speed: float, next_gear: int, balance: float | None = None
    ) -> ActuatorPositions:
        """Command (rad, slip ratio) in the engaged `gear` at `engine_speed` (rad/s) to actuator positions.

        `balance` as `brake_balance`; None is the declared one.
        """
        train = self._powertrain
        force = train.force_per_drive * drive
        available = train.drive_force(gear, engine_speed, self._vehicle.wheel_radius)
        accelerator = min(force / available, 1.0) if force > 0 and available > 0 else 0.0
        front, rear = self.brake_pressures(max(-force, 0.0), balance)
        return ActuatorPositions(self.to_steering_motor(steer), accelerator, front, rear, next_gear)

    def brake_pressures(self, force: float, balance: float | None = None) -> tuple[float, float]:
        """Front and rear pressure (Pa) for a braking force (N >= 0), held to what the brakes take.

        `balance` is held to `Powertrain.balances`: no command leaves an axle without brakes.
        """
        train = self._powertrain
        low, high = train.balances
        declared = 2 * train.brake_bias_front - 1
        share = 0.5 + 0.5 * (declared if balance is None else min(max(balance, low), high))
        total = force / train.brake_force_per_pa
        return min(total * share, train.brake_pressure_max), min(total * (1 - share), train.brake_pressure_max)

    def to_drive(self, actuators: ActuatorPositions, engine_speed: float, gear: int) -> float:
        """Equivalent slip-ratio drive command of reported or applied pedals in the engaged `gear`."""
        train = self._powertrain
        available = train.drive_force(gear, engine_speed, self._vehicle.wheel_radius)
        braking = (actuators.brake_front + actuators.brake_rear) * train.brake_force_per_pa
        return (actuators.accelerator * available - braking) / train.force_per_drive

    def to_steering_motor(self, steer: float) -> float:
        """Motor angle of a road-wheel angle, rad."""
        return steer * self._vehicle.steering_ratio

    def to_steer(self, steering_motor: float) -> float:
        """Road-wheel angle of a motor angle, rad."""
        return steering_motor / self._vehicle.steering_ratio
