"""Declared numbers of the car, shared by gateway, estimator and planner (the plant has its own)."""

from __future__ import annotations

from pydantic import Field

from hil_gateway.process.model import Model

GRAVITY = 9.80665
"""Standard gravity, m/s2."""


class Vehicle(Model):
    """Single-track vehicle data, SI. Defaults: AV-21/AV-24, public sources (docs/av24.md)."""

    mass: float = Field(default=787.3, ge=200, le=3000, description="kg")
    yaw_inertia: float = Field(default=1000.0, ge=100, le=10_000, description="kg m2")
    lf: float = Field(default=1.724, ge=0.3, le=4, description="CoG to front axle, m")
    lr: float = Field(default=1.248, ge=0.3, le=4, description="CoG to rear axle, m")
    cg_height: float = Field(default=0.275, ge=0, le=2, description="m")
    track_front: float = Field(default=1.638, ge=0.5, le=4, description="m")
    track_rear: float = Field(default=1.523, ge=0.5, le=4, description="m")
    wheel_radius: float = Field(default=0.3118, ge=0.1, le=1, description="m")
    steering_ratio: float = Field(
        default=15.0,
        ge=1,
        le=40,
        description="steering motor angle over road-wheel angle; above 40 the 240 deg of the motor "
        "no longer steer the wheels by 0.1 rad",
    )

    air_density: float = Field(default=1.2, gt=0, description="kg/m3, sea level at 20 degrees")
    drag_area: float = Field(default=0.86, ge=0, description="Cd A, m2")
    lift_area_front: float = Field(default=-0.65, le=0, description="Cl A at the front axle, m2; negative presses down")
    lift_area_rear: float = Field(default=-1.18, le=0, description="Cl A at the rear axle, m2")

    @property
    def wheelbase(self) -> float:
        """Distance between the axles, m."""
        return self.lf + self.lr

    @property
    def static_load_front(self) -> float:
        """Front axle load on level ground at rest, N."""
        return self.mass * GRAVITY * self.lr / self.wheelbase

    @property
    def static_load_rear(self) -> float:
        """Rear axle load on level ground at rest, N."""
        return self.mass * GRAVITY * self.lf / self.wheelbase
