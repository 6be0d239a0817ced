"""A car that is not the declared one, with the real planner, estimator and plant at speed."""

from __future__ import annotations

import numpy as np
import pytest

from hil_gateway.config import Config
from hil_gateway.plant.car_file import SimulatedCar
from planner.node import Planner
from planner.simulation.loop import Loop

NERVOUS = SimulatedCar(grip_front=1.17, grip_rear=0.94, mass=836.6, yaw_inertia=924.6, cg_x=0.065, downforce=1.09)
"""much grip in front, little behind, quick to turn, and tyres stiffer by half than declared"""
LATE = SimulatedCar(effects={"drive_delay": 0.15, "steer_delay": 0.06})
"""engine and brakes that act 0.15 s after their pedal and pressure are reported, road wheels 0.06 s after the motor"""
CROOKED = SimulatedCar(grip_front=1.05, grip_rear=0.86, effects={"steer_offset": -0.006})
"""a rear axle that gives way first, and wheels that point 0.34 degrees to the right of what is reported"""
IN_THE_BEND = (14.5, 17.5)
"""s, in the first fast bend of the first lap, when its tyres have been felt for ten seconds"""


@pytest.mark.slow
@pytest.mark.long
def test_a_nervous_car_does_not_weave_in_its_first_fast_bend() -> None:
    loop = Loop(Config(track="tri_oval"), simulated=NERVOUS)
    yaw_rate = []
    while loop.elapsed_s < IN_THE_BEND[1]:
        loop.step()
        yaw_rate.append(loop.plant.car["yaw_rate"])
    in_bend = np.array(yaw_rate[-round(100 * (IN_THE_BEND[1] - IN_THE_BEND[0])) :])
    swing = in_bend[50:-49] - np.convolve(in_bend, np.ones(100) / 100, "valid")
    assert loop.plant.car["vx"] > 65.0
    assert np.max(np.abs(swing)) < 0.1, "rad/s about its mean over a second"
    assert loop.finish().worst_margin_m > 0.3


@pytest.mark.slow
def test_a_steering_zero_that_is_off_is_driven_with_from_the_first_bend_on() -> None:
    loop = Loop(Config(track="road_course"), simulated=CROOKED)
    result = loop.run(seconds=25.0)
    assert result.distance_m > 600.0
    assert (result.failsafes, result.off_track, result.spins, result.slides) == ([], 0, 0, 0)


@pytest.mark.slow
@pytest.mark.long
def test_inputs_that_come_late_are_planned_with_from_the_first_bends_on() -> None:
    loop = Loop(Config(track="road_course"), simulated=LATE)
    result = loop.run(seconds=25.0)
    assert result.distance_m > 600.0
    assert (result.failsafes, result.off_track, result.spins, result.slides) == ([], 0, 0, 0)
    assert isinstance(loop.planner, Planner)
    assert loop.planner.adoption.late == (pytest.approx(0.15, abs=0.02), pytest.approx(0.06, abs=0.03))
