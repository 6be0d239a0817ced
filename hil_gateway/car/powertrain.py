"""Declared powertrain and brakes of the car: engine map, gear ratios, brake gains, and the choice of the gear.

The plant has its own; where the two differ, the tyre belief learns the difference through C_x of Eq. (2).
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, model_validator

from can_dbc.units import UNITS
from hil_gateway.car.figures import Force, In, Number, Pressure, Rpm, Seconds, Torque
from hil_gateway.process.model import Model

RPM = UNITS["rpm"].factor
"""rad/s per rpm."""
RPM_MAX = 16_000.0
"""no piston engine of a race car turns faster for long: a slip of a digit lies beyond"""
TORQUE_MAX = 2_000.0
"""N m; no engine of a race car gives so much: a slip of a digit lies beyond"""
GEARS_MAX = 10
"""no race car has more; the field of the DBC is another limit"""


LEAST_BIAS = 0.1
"""share of the pressure that is left to each axle: no axle may be without brakes"""


class Powertrain(Model):
    """Declared numbers, SI."""

    engine_rpm: Annotated[tuple[float, ...], In("rpm")]
    engine_torque: Annotated[tuple[float, ...], In("N m")] = Field(description="full throttle at `engine_rpm`, N m")
    driveline_efficiency: Number = Field(gt=0.5, le=1)
    drag_torque: Torque = Field(ge=0, description="of the engine with the throttle closed, N m")
    gears: Annotated[tuple[float, ...], In("1")]
    final_drive: Number = Field(gt=0)
    upshift_rpm: Rpm = Field(gt=0)
    downshift_rpm: Rpm = Field(gt=0, description="shift down when the lower gear turns slower")
    shift_pause_s: Seconds = Field(ge=0, description="least time between two shifts")
    clutch_rpm: Rpm = Field(gt=0, description="slowest engine speed with the clutch slipping")
    brake_force_per_pa: Annotated[float, In("N/Pa")] = Field(
        gt=0, lt=0.1, description="braking force of one axle, N per Pa"
    )
    brake_share_front: Number = Field(ge=0.2, le=0.8, description="front axle's share of the force at equal pressures")
    brake_bias_front: Number = Field(
        ge=0.2, le=0.9, description="front share of the pressure; no axle may be without brakes"
    )
    brake_bias_range: Number = Field(
        ge=0, le=0.2, description="by which a command may move that share: tyres differ by a fifth"
    )
    brake_pressure_max: Pressure = Field(ge=1.0e6, le=20.0e6, description="Pa")
    force_per_drive: Force = Field(
        ge=1e3, le=1e6, description="C_x of the tyres, which turns the command d into a force, N"
    )
    traction_max: Force = Field(gt=0, description="largest driving force that is planned, N")
    braking_max: Force = Field(gt=0, description="largest braking force that is planned, N")

    @model_validator(mode="after")
    def _tables(self) -> Self:
        """A map that cannot be read, or shifts that never end, are found before anything drives."""
        rpm = self.engine_rpm
        if len(rpm) != len(self.engine_torque):
            raise ValueError(f"engine_torque has {len(self.engine_torque)} values for {len(rpm)} of engine_rpm")
        if len(rpm) < 2 or rpm[0] <= 0 or any(b <= a for a, b in pairwise(rpm)) or not rpm[-1] <= RPM_MAX:
            raise ValueError(f"engine_rpm needs two or more rising speeds between 0 and {RPM_MAX:g}")
        if not all(0 < torque <= TORQUE_MAX for torque in self.engine_torque):
            raise ValueError(f"engine_torque must lie between 0 and {TORQUE_MAX:g} N m")
        falling = all(b < a for a, b in pairwise(self.gears))
        if not 1 <= len(self.gears) <= GEARS_MAX or not falling or not 0.1 <= self.gears[-1] <= self.gears[0] <= 20:
            raise ValueError(f"gears needs 1 to {GEARS_MAX} falling ratios between 0.1 and 20")
        if not self.clutch_rpm < self.downshift_rpm < self.upshift_rpm <= rpm[-1]:
            raise ValueError("clutch_rpm < downshift_rpm < upshift_rpm <= last engine_rpm does not hold")
        return self

    @property
    def engine_speed_max(self) -> float:
        """End of the engine map, rad/s: no shift may turn the engine faster."""
        return self.engine_rpm[-1] * RPM

    @property
    def power_max(self) -> float:
        """Greatest power of the engine at the points of its map, W."""
        return max(torque * rpm * RPM for torque, rpm in zip(self.engine_torque, self.engine_rpm, strict=True))

    @property
    def hardest_braking(self) -> float:
        """Force of both axles, N, with the greater of the declared pressures at its limit."""
        share = max(self.brake_bias_front, 1.0 - self.brake_bias_front)
        return self.brake_pressure_max * self.brake_force_per_pa / share

    @property
    def balances(self) -> tuple[float, float]:
        """Least and largest `brake_balance` a command may ask for."""
        low, high = (self.brake_bias_front + side * self.brake_bias_range for side in (-1, 1))
        return 2 * max(low, LEAST_BIAS) - 1, 2 * min(high, 1 - LEAST_BIAS) - 1

    def engine_torque_at(self, engine_speed: float) -> float:
        """Full-throttle torque at `engine_speed` (rad/s), N m, linear between the points of the map."""
        rpm, torque = self.engine_rpm, self.engine_torque
        speed = min(max(engine_speed / RPM, self.clutch_rpm, rpm[0]), rpm[-1])
        i = min(bisect_right(rpm, speed), len(rpm) - 1)
        return torque[i - 1] + (torque[i] - torque[i - 1]) * (speed - rpm[i - 1]) / (rpm[i] - rpm[i - 1])

    def ratio(self, gear: int) -> float:
        """Engine speed over wheel speed in `gear` (1..6); 0 in neutral."""
        return self.gears[gear - 1] * self.final_drive if 1 <= gear <= len(self.gears) else 0.0

    def drag_force(self, gear: int, wheel_radius: float) -> float:
        """Of the engine at the driven wheels with the throttle closed, N; 0 in neutral."""
        return self.drag_torque * self.ratio(gear) / wheel_radius

    def drive_force(self, gear: int, engine_speed: float, wheel_radius: float) -> float:
        """Full-throttle force at the driven wheels, N; 0 in neutral."""
        return self.engine_torque_at(engine_speed) * self.ratio(gear) / wheel_radius


class GearChoice:
    """Gear from road speed with hysteresis: shift up above one engine speed, down when the lower gear has room."""

    def __init__(self, powertrain: Powertrain, wheel_radius: float) -> None:
        self._powertrain = powertrain
        self._radius = wheel_radius
        self._shifted_ns: int | None = None
        self.gear = 1

    def step(self, now_ns: int, speed: float, engine_speed: float, engaged: int) -> int:
        """Gear for road speed `speed` (m/s): at most one step a `shift_pause_s`.

        `engine_speed` (rad/s) in the `engaged` gear has a veto: wheel sensors that read too low do not turn the engine
        faster than its map ends.
        """
        train = self._powertrain
        if self._shifted_ns is not None and now_ns - self._shifted_ns < train.shift_pause_s * 1e9:
            return self.gear
        change = 0
        if self._rpm(speed, self.gear) > train.upshift_rpm:
            change = self.gear < len(train.gears)
        elif self.gear > 1 and self._rpm(speed, self.gear - 1) < train.downshift_rpm:
            change = -1
        if change < 0 and self._after_shift(engine_speed, engaged, self.gear - 1) > train.engine_speed_max:
            change = 0
        if change:
            self.gear += change
            self._shifted_ns = now_ns
        return self.gear

    def _after_shift(self, engine_speed: float, engaged: int, gear: int) -> float:
        """Engine speed (rad/s) the car's motion means in `gear`."""
        ratio = self._powertrain.ratio(engaged)
        return engine_speed * self._powertrain.ratio(gear) / ratio if ratio else 0.0

    def _rpm(self, speed: float, gear: int) -> float:
        return speed / self._radius * self._powertrain.ratio(gear) / RPM
