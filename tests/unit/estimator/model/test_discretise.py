"""Integration of Eq. (1): order of convergence, mirror symmetry, agreement with an adaptive integrator."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.promise_figures import record_figure

from estimator.model.discretise import STATES, rk4, state_derivative
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from hil_gateway.car.car import load_car

MODEL = SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"))
THETA = [p.prior for p in MODEL.tyre_table]
START, CONTROL = np.array([0.0, 0.0, 0.1, 35.0, 0.4, 0.2]), np.array([0.03, 0.04])


def derivative(state: object, control: object) -> object:
    return state_derivative(MODEL, ca.vertsplit(state), ca.vertsplit(control), THETA)


def stepper(dt: float, steps: int) -> ca.Function:
    state, control = ca.SX.sym("state", len(STATES)), ca.SX.sym("control", 2)
    return ca.Function("step", [state, control], [rk4(lambda x: derivative(x, control), state, dt, steps)])


def reference(duration: float) -> np.ndarray:
    state, control = ca.SX.sym("state", len(STATES)), ca.SX.sym("control", 2)
    f = ca.Function("f", [state, control], [derivative(state, control)])
    solution = solve_ivp(lambda t, x: np.array(f(x, CONTROL)).ravel(), (0, duration), START, rtol=1e-12, atol=1e-12)
    return solution.y[:, -1]


@pytest.mark.promise("N2")
def test_rk4_converges_at_order_4() -> None:
    exact = reference(0.4)
    errors = np.array([
        np.linalg.norm(np.array(stepper(0.4, n)(START, CONTROL)).ravel() - exact) for n in (20, 40, 80)
    ])  # fmt: skip
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all((orders > 3.8) & (orders < 4.3)), orders
    record_figure("N2", f"RK4 of order {orders[0]:.2f} and {orders[1]:.2f}")


@pytest.mark.promise("N2")
def test_mirrored_car_drives_the_mirrored_path_exactly() -> None:
    rng, step = np.random.default_rng(1), stepper(0.05, 1)
    flip = np.array([1, -1, -1, 1, -1, -1.0])
    for _ in range(1000):
        state = rng.normal([0, 0, 0, 40, 0, 0], [50, 50, 1, 10, 1, 0.4])
        control = rng.normal(0, [0.05, 0.05])
        left = np.array(step(state, control)).ravel()
        right = np.array(step(state * flip, control * [-1, 1])).ravel()
        assert np.array_equal(left * flip, right)
    record_figure("N2", "mirror exact to the bit at 1,000 points")
