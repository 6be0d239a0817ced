"""Declared numbers of the car, shared by gateway, estimator and planner (the plant has its own)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from can_dbc import units
from hil_gateway.car.figures import In, Length, Number
from hil_gateway.process.model import Model

GRAVITY = units.GRAVITY
"""m/s2"""
RACE_CAR = {
    "mass": (200.0, 3000.0), "yaw_inertia": (100.0, 10_000.0), "lf": (0.3, 4.0), "lr": (0.3, 4.0),
    "cg_height": (0.0, 2.0), "track_front": (0.5, 4.0), "track_rear": (0.5, 4.0), "wheel_radius": (0.1, 1.0),
    "steering_ratio": (1.0, 40.0),
}  # fmt: skip
"""what a car that is driven may have, SI: a slip of a digit lies outside. Above a ratio of 40 the 240 deg of the
steering motor no longer steer the wheels by 0.1 rad. Logs of model cars are identified with smaller numbers."""


class Vehicle(Model):
    """Single-track vehicle data, SI."""

    mass: Annotated[float, In("kg")] = Field(gt=0, description="kg")
    yaw_inertia: Annotated[float, In("kg m2")] = Field(gt=0, description="kg m2")
    lf: Length = Field(gt=0, description="CoG to front axle, m")
    lr: Length = Field(gt=0, description="CoG to rear axle, m")
    cg_height: Length = Field(ge=0, description="m")
    track_front: Length = Field(gt=0, description="m")
    track_rear: Length = Field(gt=0, description="m")
    half_width: Length = Field(gt=0, description="from the middle to the outside of its wheels, m")
    wheel_radius: Length = Field(gt=0, description="m")
    steering_ratio: Number = Field(gt=0, description="steering motor angle over road-wheel angle")

    air_density: Annotated[float, In("kg/m3")] = Field(gt=0, description="kg/m3")
    drag_area: Annotated[float, In("m2")] = Field(ge=0, description="Cd A, m2")
    lift_area_front: Annotated[float, In("m2")] = Field(
        le=0, description="Cl A at the front axle, m2; negative presses down"
    )
    lift_area_rear: Annotated[float, In("m2")] = Field(le=0, description="Cl A at the rear axle, m2")

    def outside_a_race_car(self) -> str:
        """The first number no full-size race car has, in one line; empty where there is none."""
        for name, (low, high) in RACE_CAR.items():
            if not low <= (value := getattr(self, name)) <= high:
                return f"{name} = {value:g}: a race car has {low:g} to {high:g}"
        return ""

    @property
    def wheelbase(self) -> float:
        """Distance between the axles, m."""
        return self.lf + self.lr

    @property
    def own_time(self) -> float:
        """s, root of wheelbase over gravity: what cars of all sizes do alike takes
        as many of these (Froude's similarity): about 0.5 s for a race car, 0.13 s for one at 1:10."""
        root: float = (self.wheelbase / GRAVITY) ** 0.5
        return root

    @property
    def static_load_front(self) -> float:
        """Front axle load on level ground at rest, N."""
        return self.mass * GRAVITY * self.lr / self.wheelbase

    @property
    def static_load_rear(self) -> float:
        """Rear axle load on level ground at rest, N."""
        return self.mass * GRAVITY * self.lf / self.wheelbase

    def pressed(self, speed: float) -> float:
        """Gravity and downforce over the mass at `speed` (m/s), m/s2."""
        return GRAVITY + self.downforce(speed) / self.mass

    def axles_pressed(self, speed: float) -> tuple[float, float]:
        """The same of front and rear axle, over the mass that each carries at rest."""
        pressure = -0.5 * self.air_density * speed**2 * self.wheelbase / self.mass
        return GRAVITY + pressure * self.lift_area_front / self.lr, GRAVITY + pressure * self.lift_area_rear / self.lf

    def turns(self, speed: float, understeer: float) -> float:
        """Yaw rate over the tangent of the road-wheel angle, 1/s, at `speed` (m/s): v / (L + K v^2) with the understeer
        K, rad a m/s2 of lateral force."""
        return speed / (self.wheelbase + understeer * speed**2)

    def drag(self, speed: float) -> float:
        """Deceleration by the air at `speed` (m/s), m/s2."""
        return 0.5 * self.air_density * self.drag_area * speed**2 / self.mass

    def downforce(self, speed: float) -> float:
        """Force that presses both axles down at `speed` (m/s), N."""
        return -0.5 * self.air_density * (self.lift_area_front + self.lift_area_rear) * speed**2
