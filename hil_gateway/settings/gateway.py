"""Settings of the gateway process, with bounds under which the car can still be steered and stopped."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, Self

from pydantic import Field, model_validator

from hil_gateway.car.car import Car, load_car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model

PERIOD_S = 0.01
"""of the gateway: cars expect their commands at 100 Hz"""
PERIOD_NS = round(PERIOD_S * NS_PER_S)
LEAST_STEERING = 0.2
"""rad/s at the road wheel: 0.1 rad in half a second, or the car could no longer be steered around a bend"""
LEAST_RISE, LEAST_FALL = 2.0, 1.0
"""1/s, of the full pressure: it is there within half a second, and gone within one, or the car does not roll again"""
LEAST_ACCELERATOR = 0.2
"""1/s: full throttle within five seconds"""


class CommandRates(NamedTuple):
    """Fastest moves that are let out, SI."""

    steering: float
    """rad/s, at the motor"""
    accelerator_rise: float
    """1/s; falling is never held back"""
    brake_rise: float
    """Pa/s"""
    brake_fall: float


class LimitConfig(Model):
    """Slower moves than the car's own (`[actuators]` of its car.toml), which hold where nothing is given."""

    steering_rate: float | None = Field(default=None, description="motor angle, deg/s")
    accelerator_rise: float | None = Field(default=None, description="%/s; falling is never held back")
    brake_rise: float | None = Field(default=None, description="kPa/s")
    brake_fall: float | None = Field(default=None, description="kPa/s")

    def within(self, car: Car) -> CommandRates:
        """Rates in force, in SI.

        Raises:
            ValueError: faster than the car's own, or so slow that it could not be steered or stopped.
        """
        own, full = car.actuators, car.powertrain.brake_pressure_max
        steering = LEAST_STEERING * car.vehicle.steering_ratio
        return CommandRates(
            self._rate("steering_rate", math.radians(1.0), (steering, own.steering_rate)),
            self._rate("accelerator_rise", 0.01, (LEAST_ACCELERATOR, own.accelerator_rise)),
            self._rate("brake_rise", 1e3, (LEAST_RISE * full, own.brake_rise)),
            self._rate("brake_fall", 1e3, (LEAST_FALL * full, own.brake_fall)),
        )

    def _rate(self, key: str, unit: float, bounds: tuple[float, float]) -> float:
        """The configured rate, or the car's, in SI; `unit` is that of the setting."""
        low, high = bounds
        given: float | None = getattr(self, key)
        rate = high if given is None else given * unit
        if given is None and rate < low:
            unsteered = "slower, the car is not steered or stopped"
            raise ValueError(f"actuators.{key} of car.toml is {rate / unit:g}, {low / unit:g} are needed: {unsteered}")
        if not low * (1 - ROUNDED) <= rate <= high * (1 + ROUNDED):
            raise ValueError(f"gateway.limits.{key} = {rate / unit:g}: between {low / unit:g} and {high / unit:g}")
        return rate


STOPS = "controlled", "emergency"
ROUNDED = 1e-9
"""share by which a rate may pass its bound: units are converted"""


CAUTION_DECELERATION = 3.0
"""m/s2 under yellow and towards a pit lane: mild for the cars behind, and any tyre holds it beside cornering"""
LEAST_BRAKES = 3.0
"""m/s2 that the brakes give: a stop from 60 m/s takes 600 m with it"""
LEAST_SHARE = 0.3
"""of its grip that is braked with at least, however large the lateral force: in a banked bend tyres bear more, and
steering alone holds a car no better"""


def beside(across: float, most: float) -> float:
    """What the friction circle leaves along the wheels of a force `most` beside one across them (W. F. Milliken and
    D. L. Milliken, Race Car Vehicle Dynamics, 1995, ch. 2)."""
    return math.sqrt(max(most**2 - across**2, (LEAST_SHARE * most) ** 2))


class StopConfig(Model):
    """How hard the gateway brakes by itself."""

    controlled_deceleration: float = Field(
        default=6.0, ge=LEAST_BRAKES, le=30, description="m/s2; below 3 a stop from 60 m/s takes more than 600 m"
    )
    emergency_deceleration: float = Field(
        default=12.0, ge=LEAST_BRAKES, le=30, description="m/s2 on a straight at low speed"
    )
    lateral_grip: float = Field(
        default_factory=lambda: load_car().tyres.grip, ge=0.3, le=4,
        description="lateral specific force the tyres hold, g; not given: the car's",
    )  # fmt: skip

    def grip(self, vehicle: Vehicle, speed: float) -> float:
        """Specific force that the declared grip of the tyres makes at `speed` (m/s), m/s2."""
        return self.lateral_grip * vehicle.pressed(speed)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.emergency_deceleration < self.controlled_deceleration:
            raise ValueError("emergency_deceleration is less than controlled_deceleration")
        return self


def stop_of(car: Car) -> dict[str, float]:
    """What the settings of a stop are for a car where nothing else is given: no harder than its brakes can."""
    brakes, usual = car.powertrain.hardest_braking / car.vehicle.mass, StopConfig.model_fields
    if brakes < LEAST_BRAKES:
        raise InputError(f"{car.platform}: car.toml: the brakes give {brakes:.2g} m/s2, {LEAST_BRAKES:g} are needed")
    return {
        "lateral_grip": car.tyres.grip,
        **{f"{kind}_deceleration": min(usual[f"{kind}_deceleration"].default, brakes) for kind in STOPS},
    }


class ArmingConfig(Model):
    """What arming asks for."""

    heading: Literal["first_metres", "known"] = Field(
        default="first_metres", description="the first metres, at walking pace, may show where the car points"
    )


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
    arming: ArmingConfig = ArmingConfig()
    hold: bool = Field(
        default=True, description="brakes hold the standing car whenever it obeys commands; false: only in a stop"
    )
    limits: LimitConfig = LimitConfig()
    stop: StopConfig = StopConfig()
