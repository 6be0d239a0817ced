"""Cars nobody has driven: they differ from the declared one as cars do."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil_gateway.plant.car_file import NoiseFactors, SimulatedCar
from hil_gateway.plant.physics.effects import configure

GRIP_SPREAD = 0.2
"""tyre grip of a car nobody has driven, of the declared, either way"""
DATA_SPREAD = (0.05, 0.1)
"""by how much, at least and at most, mass, yaw inertia, aero and brake bias are off"""
CG_SPREAD_M = (0.05, 0.1)
"""5 to 10 % of the distance to an axle, about 1 m; a centre of gravity cannot be weighed much better"""
POWER_SPREAD = 0.1
"""brakes and engine"""
NOISE_OCTAVES = 1.0
"""noise of a sensor, of the declared: half to twice, as far as data sheets say"""


def random_car(seed: int) -> SimulatedCar:
    """A car that differs from the declared one as cars do; one seed, one car."""
    draw = np.random.default_rng([20, seed])

    def off(spread: tuple[float, float]) -> float:
        return float(draw.choice([-1.0, 1.0]) * draw.uniform(*spread))

    def within(spread: float) -> float:
        return round(1.0 + float(draw.uniform(-spread, spread)), 4)

    usual: Any = configure().car
    return SimulatedCar(
        grip_front=within(GRIP_SPREAD),
        grip_rear=within(GRIP_SPREAD),
        mass=round(usual.mass * (1.0 + off(DATA_SPREAD)), 1),
        yaw_inertia=round(usual.yaw_inertia * (1.0 + off(DATA_SPREAD)), 1),
        cg_x=round(off(CG_SPREAD_M), 4),
        downforce=round(1.0 + off(DATA_SPREAD), 4),
        drag=round(1.0 + off(DATA_SPREAD), 4),
        brake_bias=round(1.0 + off(DATA_SPREAD), 4),
        brake_gain=within(POWER_SPREAD),
        engine_torque=within(POWER_SPREAD),
    )


def with_other_noise(car: SimulatedCar, seed: int) -> SimulatedCar:
    """The car with sensors whose noise is not the declared one; one seed, one set of sensors."""
    draw = np.random.default_rng([21, seed])
    noise = {name: 2.0 ** float(draw.uniform(-NOISE_OCTAVES, NOISE_OCTAVES)) for name in NoiseFactors.model_fields}
    return car.model_copy(update={"noise": NoiseFactors(**noise)})
