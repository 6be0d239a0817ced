"""Instruction lists run by the C program against numpy, operation by operation and for a whole model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from estimator.model.columns import Columns
from estimator.model.effects import catalogue
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from estimator.offline.predict import compiled_columns
from estimator.offline.predict.compiled_columns import CompiledColumns
from estimator.offline.predict.expressions import functions_of
from hil_gateway.car.car import load_car
from hil_gateway.process.compiled import find_compiler

SAMPLES = 1000
"""more than one run of the program, and no multiple of what it takes at once"""

OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "sums": lambda x, y: x + y - 2 * x * y + x / (3 + y) - (-x) + 1 / (2 + x),
    "powers": lambda x, y: x**2 + (2 + y) ** 1.7 + (2 + x) ** y + ca.sqrt(1 + x * x),
    "limits": lambda x, y: ca.fmin(x, y) + 3 * ca.fmax(x, 0.1) + ca.fabs(y) + ca.sign(x) + ca.floor(3 * x) - ca.ceil(y),
    "choices": lambda x, y: ca.if_else(x < y, x, 2 * y) + ca.if_else(ca.logic_and(x > 0, y <= 0.5), 1.0, x),
    "truths": lambda x, y: ca.logic_or(x > 0.3, y < -0.3) + 2 * ca.logic_not(x > y) + (x == y) + 3 * (x != y),
    "angles": lambda x, y: ca.sin(x) + ca.cos(y) + ca.tan(x) + ca.asin(x) + ca.acos(y) + ca.atan(x) + ca.atan2(x, y),
    "exponentials": lambda x, y: ca.exp(x) + ca.log(2 + y) + ca.sinh(x) + ca.cosh(y) + ca.tanh(x),
    "near zero": lambda x, y: ca.log1p(0.5 * x) + ca.expm1(y) + ca.hypot(x, y) + ca.copysign(x, y) + ca.fmod(x, 0.3),
}

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler: numpy runs the instructions")


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=OPERATIONS)
def test_every_operation_gives_what_numpy_gives(operation: Callable[[Any, Any], Any]) -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    out = ca.vertcat(operation(x[0], x[1]), operation(x[1], p[1]) + p[0], 0.0)
    f = ca.Function("f", [x, p], [ca.densify(out)])
    inputs = np.random.default_rng(1).uniform(-0.9, 0.9, size=(2, SAMPLES))
    shared, each = np.array([0.4, -0.2]), np.random.default_rng(2).uniform(-0.9, 0.9, size=(2, SAMPLES))
    for parameters in (shared, each):
        plain = Columns(f)(inputs, parameters)
        np.testing.assert_allclose(CompiledColumns(f)(inputs, parameters), plain, rtol=1e-13, atol=1e-14)


def test_a_model_with_many_effects_gives_what_numpy_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("brake_pressure", "load_transfer", "tyre_relaxation", "limited_slip", "aero_drag", "gear_shift")
    model = SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"), tuple(catalogue()[n] for n in names))
    functions = functions_of(model)
    rng = np.random.default_rng(3)
    inputs = rng.uniform(0.5, 1.5, size=(functions.inputs.numel(), SAMPLES))
    theta = rng.uniform(0.5, 1.5, size=functions.theta.numel())
    compiled = functions.derivatives(inputs, theta)
    monkeypatch.setattr(compiled_columns, "columns_library", lambda: None)
    np.testing.assert_allclose(compiled, functions.derivatives(inputs, theta), rtol=1e-11, atol=1e-11)
