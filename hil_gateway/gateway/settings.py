"""Settings of the gateway process, with bounds under which the car can still be steered and stopped."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.model import Model

PERIOD_S = 0.01
"""of the gateway: the car expects its commands at 100 Hz (can_dbc/av24.toml)"""


class LimitConfig(Model):
    """Fastest moves the gateway lets out; value limits are the car's own (can_dbc/av24.toml).

    Slower than the least ones here the car could no longer be steered around a bend (0.1 rad at the wheels in half a
    second), braked in time (full pressure in half a second) or let roll again (pressure gone in a second). All of them
    are many raw steps a frame: no rate rounds to nothing.
    """

    steering_rate: float = Field(default=500.0, ge=200, le=500, description="motor angle, deg/s")
    accelerator_rise: float = Field(default=400.0, ge=20, le=1000, description="%/s; falling is never held back")
    brake_rise: float = Field(default=180_000.0, ge=12_000, le=180_000, description="kPa/s")
    brake_fall: float = Field(default=60_000.0, ge=6_000, le=180_000, description="kPa/s")


class StopConfig(Model):
    """How hard the gateway brakes by itself."""

    controlled_deceleration: float = Field(
        default=6.0, ge=3, le=30, description="m/s2; below 3 a stop from 60 m/s takes more than 600 m"
    )
    emergency_deceleration: float = Field(default=12.0, ge=3, le=30, description="m/s2 on a straight at low speed")
    lateral_grip: float = Field(default=1.3, ge=0.3, le=4, description="lateral specific force the tyres hold, g")
    downforce: float = Field(default=1.12, ge=0, le=20, description="N per (m/s)^2, both axles: grip grows with it")
    hold_pressure: float = Field(
        default=2.0e6, ge=5.0e5, le=6.0e6, description="brake pressure at standstill, Pa; 0.25 MPa hold on a 10 % grade"
    )

    def grip(self, mass: float, speed: float) -> float:
        """Specific force that the declared grip of the tyres makes at `speed` (m/s) of a car of `mass` (kg), m/s2."""
        return self.lateral_grip * (GRAVITY + self.downforce * speed**2 / mass)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.emergency_deceleration < self.controlled_deceleration:
            raise ValueError("emergency_deceleration is less than controlled_deceleration")
        return self


class GatewayConfig(Model):
    """Gateway process."""

    mode: Literal["listen", "shadow", "actuator_test", "armed"] = "armed"
    vehicle_number: int = Field(default=1, ge=0, le=255)
    command_latency_max_s: float = Field(
        default=0.15, ge=0.05, le=0.5, description="older states are not answered any more"
    )
    caution_speed: float = Field(
        default=22.0, ge=5, le=60, description="m/s under yellow flags, when race control names no speed"
    )
    hold: bool = Field(
        default=True, description="brakes hold the standing car whenever it obeys commands; false: only in a stop"
    )
    limits: LimitConfig = LimitConfig()
    stop: StopConfig = StopConfig()
