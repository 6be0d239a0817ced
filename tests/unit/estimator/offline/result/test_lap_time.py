"""The lap time that a model's errors cost, against laps of two bends and two straights in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.offline.result.lap_time import change_of_lap_time
from hil_gateway.process.arrays import Array

STEP, RADIUS, STRAIGHT_M = 0.002, 60.0, 400.0


def lap(grip: float, driving: float, braking: float) -> tuple[Array, Array, float]:
    """(n,) speed and lateral acceleration of a lap, and its time by the equations of constant acceleration."""
    bend = np.sqrt(grip * RADIUS)
    top = np.sqrt(bend**2 + 2.0 * STRAIGHT_M * driving * braking / (driving + braking))
    cornering, up, down = np.pi * RADIUS / bend, (top - bend) / driving, (top - bend) / braking
    once = [
        np.full(round(cornering / STEP), bend),
        bend + driving * STEP * np.arange(round(up / STEP)),
        top - braking * STEP * np.arange(round(down / STEP)),
    ]
    sideways = np.concatenate([np.full(len(once[0]), grip), np.zeros(len(once[1]) + len(once[2]))])
    return np.tile(np.concatenate(once), 2), np.tile(sideways, 2), 2.0 * float(cornering + up + down)


@pytest.mark.parametrize(
    ("grip", "driving", "braking"), [(12.24, 5.0, 9.0), (12.0, 5.1, 9.0), (12.0, 5.0, 9.2), (11.9, 5.05, 9.1)]
)
@pytest.mark.parametrize("begins", [0, 3000])
def test_the_lap_time_of_a_model_is_that_of_a_car_with_its_forces(
    grip: float, driving: float, braking: float, begins: int
) -> None:
    speed, sideways, driven = lap(12.0, 5.0, 9.0)
    forward = np.gradient(speed, STEP)
    along = np.where(sideways > 0, 0.0, np.where(forward > 0, 5.0 - driving, braking - 9.0))
    across = sideways / 12.0 * (12.0 - grip)
    change = change_of_lap_time(*(np.roll(v, begins) for v in (speed, sideways, along, across)), STEP)
    assert change == pytest.approx(lap(grip, driving, braking)[2] - driven, rel=0.08)


def test_a_model_without_errors_drives_the_driven_lap() -> None:
    speed, sideways, _ = lap(12.0, 5.0, 9.0)
    nothing = np.zeros(len(speed))
    assert change_of_lap_time(speed, sideways, nothing, nothing, STEP) == 0.0
