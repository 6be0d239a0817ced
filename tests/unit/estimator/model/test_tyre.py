import casadi as ca
import numpy as np
import pytest

from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from estimator.model.tyre import (
    AXLES,
    force_derivatives,
    front_and_rear,
    load_rows,
    normalised_force,
    slip_at_peak,
)
from hil_gateway.car.car import load_car

CURVE = (9.0, 1.35, 1.4)
SLIPS = np.linspace(-0.4, 0.4, 41)


def test_numpy_and_casadi_give_the_same_force() -> None:
    slip = ca.SX.sym("slip")
    symbolic = ca.Function("f", [slip], [normalised_force(slip, *CURVE)])
    assert np.array(symbolic(SLIPS)).ravel() == pytest.approx(normalised_force(SLIPS, *CURVE), abs=1e-15)


def test_derivatives_are_those_of_the_curve() -> None:
    given = force_derivatives(SLIPS, *map(np.array, CURVE))
    for k in range(3):
        up, down = ([v + sign * 1e-6 * (i == k) for i, v in enumerate(CURVE)] for sign in (1, -1))
        assert given[:, k] == pytest.approx(
            (normalised_force(SLIPS, *up) - normalised_force(SLIPS, *down)) / 2e-6, abs=1e-8
        )


def test_no_slip_gives_more_force_than_the_slip_at_peak() -> None:
    peak = slip_at_peak(*CURVE[:2])
    assert normalised_force(np.array(peak), *CURVE) == pytest.approx(CURVE[2])
    assert np.abs(normalised_force(SLIPS, *CURVE)).max() <= CURVE[2]


def test_a_curve_without_a_peak_grows_up_to_a_right_angle() -> None:
    assert slip_at_peak(9.0, 0.9) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("layout", ["shared", "per_axle"])
def test_axles_name_every_parameter_of_the_model_but_the_longitudinal_one(layout: str) -> None:
    names = [p.name for p in SingleTrack(load_car().vehicle, tyre_prior(load_car(), layout)).tyre_table]  # type: ignore[arg-type]
    named = [n for axle in AXLES[layout] for n in axle.parameters]  # type: ignore[index]
    assert ["cx", *named] == names


def test_only_the_driven_axle_depends_on_the_longitudinal_stiffness() -> None:
    names = ["cx", "bf", "cf", "df", "br", "cr", "dr"]
    assert load_rows(names, "per_axle") == ((1, 2, 3), (0, 4, 5, 6))
    front, rear = front_and_rear("shared")
    assert front is rear
