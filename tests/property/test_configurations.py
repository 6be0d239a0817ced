"""Promise D3: whatever configuration is accepted, the car can be steered and stopped with it."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from support.promise_figures import record_figure, volume

from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.config import Config
from hil_gateway.gateway.act.limits import Limits
from hil_gateway.process.errors import InputError

KEYS = {
    "gateway.limits.steering_rate": 500.0, "gateway.limits.accelerator_rise": 400.0,
    "gateway.limits.brake_rise": 180e3, "gateway.limits.brake_fall": 60e3,
    "gateway.stop.controlled_deceleration": 6.0, "gateway.stop.emergency_deceleration": 12.0,
    "gateway.stop.lateral_grip": 1.3, "vehicle.mass": 787.3,
    "vehicle.steering_ratio": 15.0, "powertrain.brake_force_per_pa": 1.8e-3, "powertrain.brake_bias_front": 0.54,
    "powertrain.brake_pressure_max": 6e6, "powertrain.force_per_drive": 5e4, "powertrain.upshift_rpm": 6500.0,
    "powertrain.downshift_rpm": 5700.0, "powertrain.clutch_rpm": 2000.0,
}  # fmt: skip
STEER = 0.1
"""rad at the wheels: half a second must be enough for so much (docs/failsafe.md)"""


def random_tree(rng: random.Random) -> dict[str, Any]:
    """The defaults with one to three numbers anything between a ten-thousandth and a hundredfold."""
    tree: dict[str, Any] = {}
    for key in rng.sample(sorted(KEYS), k=rng.randint(1, 3)):
        section, *rest = key.split(".")
        at = tree.setdefault(section, {})
        for part in rest[:-1]:
            at = at.setdefault(part, {})
        factor = rng.choice((10 ** rng.uniform(-4, 2), rng.uniform(0.3, 1.5), 0.0, -1.0))
        at[rest[-1]] = KEYS[key] * factor
    return tree


def reached(limits: Limits, wanted: ActuatorPositions, seconds: float) -> ActuatorPositions:
    """Where commands are after so long, from rest."""
    command = limits.resting(0.0)
    for _ in range(round(100 * seconds)):
        command, _ = limits.apply(wanted, command)
    return limits.to_actuators(command)


def check(config: Config) -> None:
    """Steering turns the wheels, the brakes bite and let go, the stop that is asked for can be had."""
    limits, actuation = (
        Limits(config.car, config.gateway.limits.within(config.car)),
        Actuation(config.vehicle, config.powertrain),
    )
    for side in (1.0, -1.0):
        motor = actuation.to_steering_motor(side * STEER)
        assert reached(limits, ActuatorPositions(motor, 0, 0, 0, 1), 2.1).steering_motor == pytest.approx(
            motor, abs=0.02
        )
    force = config.vehicle.mass * config.gateway.stop.emergency_deceleration
    front, rear = actuation.brake_pressures(force)
    assert (front + rear) * config.powertrain.brake_force_per_pa == pytest.approx(force, rel=1e-6)
    braked = reached(limits, ActuatorPositions(0, 0, front, rear, 1), 0.6)
    ceiling = limits.signals["brake_front"].high * limits.signals["brake_front"].scale
    assert braked.brake_front >= min(front, ceiling) - 1e3
    assert braked.brake_rear >= min(rear, ceiling) - 1e3
    assert max(front, rear) <= ceiling
    for gear in range(1, len(config.powertrain.gears) + 1):
        for rpm in (0.0, 1000.0, 5000.0, 20_000.0):
            assert math.isfinite(config.powertrain.drive_force(gear, rpm, config.vehicle.wheel_radius))


@pytest.mark.promise("D3")
def test_every_accepted_configuration_steers_and_brakes() -> None:
    rng, accepted = random.Random(16), 0
    tried = volume(2_000, 10_000)
    for _ in range(tried):
        tree = random_tree(rng)
        try:
            config = Config.model_validate(tree)
        except (ValueError, InputError):
            continue
        accepted += 1
        check(config)
    assert accepted > tried / 20
    assert accepted < tried, "something must have been refused"
    record_figure("D3", f"{tried:,} random configurations, {accepted:,} accepted: each steers, brakes and lets go")
