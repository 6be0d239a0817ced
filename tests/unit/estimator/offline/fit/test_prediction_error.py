"""The fit by prediction error: its derivatives, its normal equations, its way from a far start."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import PRIOR, record_of

from estimator.model.effects import catalogue
from estimator.model.single_track import SingleTrack
from estimator.offline.fit.normal import Normal
from estimator.offline.fit.prediction_error import Point, fit, residual
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from hil_gateway.car.car import load_car
from hil_gateway.process.arrays import Array


def test_sensitivities_agree_with_finite_differences(drives: dict[str, Any]) -> None:
    record = record_of(drives["single"])
    record = record.select(np.arange(record.windows) % 12 == 0)
    names = ("aero_drag", "steer_scale", "steer_delay", "road_bank")
    model = SingleTrack(load_car().vehicle, PRIOR, tuple(catalogue()[n] for n in names))
    predictor = Predictor(model, record)
    at = predictor.start([*PRIOR.values()])
    at[7], at[9] = 0.3, 0.04
    noise = ResidualNoise.white(record.block_noise)
    # about measured states the residual is small, so the projection and the exponential may be taken as constant
    jacobian = Point.at(predictor, at, noise).sensitivity.dense
    for i in (0, 1, 7, 8, 9, 12):
        step = 1e-3 * predictor.table[i].prior_std * np.eye(len(at))[i]
        ahead = residual(predictor, at + step, noise)
        behind = residual(predictor, at - step, noise)
        numeric = -(ahead - behind) / (2 * step[i])
        scale = np.abs(numeric).max()
        assert np.sqrt(np.mean((jacobian[:, i] - numeric) ** 2)) < 0.05 * scale, predictor.table[i].name


def linear_problem() -> tuple[Array, Array, Callable[[Array, Array], Normal]]:
    """(laps, n, p) sensitivity, (laps, n) residual of the first channel, and the normal equations of such."""
    rng = np.random.default_rng(5)
    X, truth = rng.normal(size=(4, 60, 3)), np.array([1.0, -2.0, 0.5])

    def normal(X: Array, y: Array) -> Normal:
        laps, n, p = X.shape
        squares, gradient, hessian = np.zeros((5, laps)), np.zeros((5, laps, p)), np.zeros((5, laps, p, p))
        squares[0], gradient[0] = (y**2).sum(axis=1), np.einsum("lnp,ln->lp", X, y)
        hessian[0] = np.einsum("lnp,lnq->lpq", X, X)
        return Normal(squares, gradient, hessian, np.full(laps, float(n)), np.zeros((p, p)), np.zeros(p), np.ones(5))

    return X, X @ truth + 0.1 * rng.normal(size=(4, 60)), normal


def test_leaving_a_lap_out_by_normal_equations_is_exact_for_a_linear_model() -> None:
    X, y, normal = linear_problem()
    held_out = normal(X, y).held_out(np.ones(5))[0]
    for lap in range(len(X)):
        others = [k for k in range(len(X)) if k != lap]
        beta = np.linalg.lstsq(np.concatenate(X[others]), np.concatenate(y[others]), rcond=None)[0]
        assert held_out[lap] == pytest.approx(np.sum((y[lap] - X[lap] @ beta) ** 2), rel=1e-6)


def test_normal_equations_with_a_parameter_held_elsewhere_are_exact_for_a_linear_model() -> None:
    X, y, normal = linear_problem()
    moved, made_there = normal(X, y).at(np.array([1]), np.array([-0.7])), normal(X[..., [0, 2]], y + 0.7 * X[..., 1])
    for found, exact in zip(vars(moved).values(), vars(made_there).values(), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-9)


def test_fit_recovers_from_a_far_start(drives: dict[str, Any]) -> None:
    record = record_of(drives["none"])
    predictor = Predictor(SingleTrack(load_car().vehicle, PRIOR), record)
    near = fit(predictor, np.array([*PRIOR.values()]))
    far = fit(predictor, np.array([60000.0, 5.0, 2.0, 2.3, 14.0, 1.1, 2.2]), iterations=30)
    np.testing.assert_allclose(far.parameters, near.parameters, rtol=0.02)
