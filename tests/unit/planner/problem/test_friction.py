"""Force along against force across: the shape of the ellipse, and against the tyres of the simulated car."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.model.effects import catalogue
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from hil_gateway.car.car import load_car
from hil_gateway.plant.physics.parameters import CarParameters
from hil_gateway.plant.physics.tyre import Curve, magic_formula
from planner.problem.friction import along_share, counted, left_across

LOADS = np.linspace(0.0, 1.05, 22)


def _share(k: float) -> float:
    return float(
        along_share(
            SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"), (catalogue()["combined_slip"],)),
            [k],
        )
    )


@pytest.mark.parametrize("share", [0.85, 0.92, 1.0])
def test_what_is_left_across_is_on_the_ellipse(share: float) -> None:
    along = LOADS[1.0 / share >= LOADS]
    across = left_across(share, along)
    used = [np.hypot(float(counted(share, w, -1e4)) * x, w) for x, w in zip(along, across, strict=True)]
    assert np.max(np.abs(np.array(used) - 1.0)) < 2e-3
    assert np.all(np.diff(across) < 0.0)


def test_no_force_is_left_across_beside_more_than_the_peak_along() -> None:
    assert np.all(left_across(0.9, np.array([1.0 / 0.9, 1.2, 3.0])) == 0.0)


def test_in_a_bend_the_ellipse_is_a_circle() -> None:
    assert [float(counted(0.85, w, -1e4)) for w in (0.5, 0.8, 1.0)] == [1.0, 1.0, 1.0]


@given(st.floats(0.7, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1e4))
def test_traction_counts_for_no_less_than_braking_and_cornering_for_no_less_than_straights(
    share: float, across: float, force: float
) -> None:
    driving, braking = (float(counted(share, across, sign * force)) for sign in (1.0, -1.0))
    assert share - 1e-9 <= braking <= driving <= 1.0
    assert braking >= float(counted(share, 0.0, -force)) - 1e-9


def test_a_driven_axle_is_on_a_circle_and_a_braked_one_straight_on_is_not() -> None:
    """A driven axle at its peak is what turns a car round; 3 kN is a quarter of an axle's grip."""
    assert float(counted(0.8, 0.0, 3000.0)) > 0.999
    assert float(counted(0.8, 0.0, -3000.0)) < 0.801


def test_a_model_that_does_not_tell_the_two_apart_has_a_circle() -> None:
    assert (
        along_share(
            SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle")),
            ca.SX(0, 1),
        )
        == 1.0
    )
    assert _share(1.0) == _share(1.4) == 1.0, "more across than along is not counted on"


def test_half_of_what_combined_slip_shows_is_believed() -> None:
    assert _share(0.8) == pytest.approx(0.9)


@pytest.mark.parametrize("k", [0.80, 0.87])
def test_braking_straight_on_stays_below_the_peak_of_the_simulated_cars_tyres(k: float) -> None:
    """What cars learn of k and D: 1.44 front, 1.49 rear, of axles whose wheels share the load unequally in a bend."""
    car = CarParameters()
    peak = max(float(magic_formula(s, Curve(car.bx, car.cx, car.dx, car.ex))) for s in np.linspace(0.02, 0.3, 141))
    for learnt in (1.44, 1.49):
        assert 0.98 * learnt / _share(k) < peak
