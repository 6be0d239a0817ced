"""A simulated car in a file: what differs from a base car, undeclared effects, and what happens during a run.

```json
{"base": "av24", "grip_front": 0.9, "mass": 810, "cg_x": 0.03, "brake_gain": 0.95, "effects": {"wind": 8.0},
 "events": [{"kind": "grip", "t": 40, "for_s": 6, "factor": 0.7}, {"kind": "puncture", "t": 120, "wheel": "rl"}]}
```

Only the plant and the referee read it; the processes that drive never do.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from hil_gateway.plant.events import Event
from hil_gateway.plant.physics.effects import configure
from hil_gateway.plant.physics.parameters import CarParameters, PlantParameters, SensorParameters
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model
from hil_gateway.text_file import read_json

Factor = Annotated[float, Field(gt=0.3, lt=3.0)]
Noisier = Annotated[float, Field(ge=0.0, le=10.0)]


class NoiseFactors(Model):
    """Noise of the sensors over that of the base car."""

    acceleration: Noisier = 1.0
    yaw_rate: Noisier = 1.0
    speed: Noisier = 1.0
    position: Noisier = 1.0
    steer: Noisier = 1.0

    def apply(self, sensors: SensorParameters) -> SensorParameters:
        """Sensors with this noise."""
        names = {f"{name}_noise": factor for name, factor in self}
        return replace(sensors, **{name: factor * getattr(sensors, name) for name, factor in names.items()})


class SimulatedCar(Model):
    """Differences from the base: `grip_*`, `downforce`, `drag`, `brake_*`, `engine_torque` are factors."""

    base: Literal["av24", "paper"] = "av24"
    grip_front: Factor = 1.0
    grip_rear: Factor = 1.0
    mass: float | None = Field(default=None, gt=200, lt=3000, description="kg")
    yaw_inertia: float | None = Field(default=None, gt=200, lt=10_000, description="kg m2")
    cg_x: float = Field(default=0.0, ge=-0.5, le=0.5, description="centre of gravity moved forward, m")
    downforce: float = Field(default=1.0, ge=0, lt=3)
    drag: float = Field(default=1.0, ge=0, lt=3)
    brake_gain: Factor = 1.0
    brake_bias: float = Field(default=1.0, gt=0.5, lt=1.5, description="front share of the torque, of the base's")
    engine_torque: Factor = 1.0
    effects: dict[str, float] = Field(default={}, description="undeclared effect -> size")
    noise: NoiseFactors = NoiseFactors()
    events: tuple[Event, ...] = ()

    def parameters(self) -> PlantParameters:
        """Parameters of the plant.

        Raises:
            InputError: unknown effect, or a size outside its range.
        """
        base = configure(self.base, self.effects)
        return replace(base, car=self._apply(base.car), sensors=self.noise.apply(base.sensors))

    def _apply(self, car: CarParameters) -> CarParameters:
        front, rear = self._brakes(car)
        return replace(
            car,
            grip_front=car.grip_front * self.grip_front,
            grip_rear=car.grip_rear * self.grip_rear,
            mass=self.mass or car.mass,
            yaw_inertia=self.yaw_inertia or car.yaw_inertia,
            lf=car.lf - self.cg_x,
            lr=car.lr + self.cg_x,
            downforce=car.downforce * self.downforce,
            drag=car.drag * self.drag,
            brake_gain_front=front,
            brake_gain_rear=rear,
            engine_torque=tuple(torque * self.engine_torque for torque in car.engine_torque),
        )

    def _brakes(self, car: CarParameters) -> tuple[float, float]:
        both = car.brake_gain_front + car.brake_gain_rear
        front = car.brake_gain_front * self.brake_bias
        return self.brake_gain * front, self.brake_gain * (both - front)


def read_car(path: Path | str) -> SimulatedCar:
    """Read a car file.

    Raises:
        InputError: unreadable, an unknown key, a value out of range, an unknown effect; names file and key.
    """
    try:
        car = SimulatedCar.model_validate(read_json(path, "car"))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        given = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise InputError(f"{path}: {key}{given}: {first['msg'].lower()}; known: {_known()}") from None
    try:
        car.parameters()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return car


def _known() -> str:
    return ", ".join(SimulatedCar.model_fields)
