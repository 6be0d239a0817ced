"""The speed profile asks for what Eq. (10) leaves at every choice of theta, and no less."""

from __future__ import annotations

import numpy as np
import pytest

from planner.adoption.usable_grip import PROFILE_SHARE, lateral_shape, usable_grip, usable_share
from planner.plan.controller import TyreKnowledge
from planner.problem.infomax import sigma_points

AXLES = ((1, 2, 3), (4, 5, 6))
THETA = np.array([50_000.0, 9.0, 1.35, 1.3567, 10.0, 1.4, 1.3392])
LIMIT = (1.22, 1.205)


def knowledge(covariance: np.ndarray) -> TyreKnowledge:
    return TyreKnowledge(THETA, THETA, covariance, 0.4 * THETA, LIMIT, LIMIT)


def test_a_certain_belief_leaves_the_load_limit_less_what_corrections_need() -> None:
    share = usable_share(AXLES, knowledge(np.zeros((7, 7))), 1.0)
    assert share == pytest.approx(PROFILE_SHARE * min(LIMIT[0] / THETA[3], LIMIT[1] / THETA[6]), rel=0.01)


def test_independent_doubts_cost_as_much_as_the_peak_is_uncertain() -> None:
    share = usable_share(AXLES, knowledge(np.diag((0.2 * THETA) ** 2)), 1.0)
    assert share == pytest.approx(PROFILE_SHARE * 0.9 / 1.2, rel=0.02)


def test_parameters_known_only_together_cost_little_where_the_force_is_known() -> None:
    """C and D are in doubt by a third, but force up to 0.09 rad has been measured to 4 %."""
    slips = np.linspace(0.0, 0.09, 50)
    shapes = []
    for i in range(3):
        up, down = (THETA[1:4].copy() for _ in range(2))
        up[i] *= 1.001
        down[i] *= 0.999
        difference = [t[2] * np.sin(t[1] * np.arctan(t[0] * slips)) for t in (up, down)]
        shapes.append((difference[0] - difference[1]) / (0.002 * THETA[1 + i]))
    H = np.array(shapes).T / 0.04
    front = np.linalg.inv(H.T @ H + np.diag(1.0 / (0.4 * THETA[1:4]) ** 2))
    covariance = np.zeros((7, 7))
    covariance[1:4, 1:4] = front
    marginal = np.sqrt(front[2, 2]) / THETA[3]
    share = usable_share(AXLES, knowledge(covariance), 1.0)
    assert marginal > 0.1
    assert share > 1.03 * PROFILE_SHARE * 0.9 / (1.0 + marginal)


def test_within_the_profile_no_choice_of_theta_exceeds_the_limit() -> None:
    covariance = np.diag((0.15 * THETA) ** 2)
    share = usable_share(AXLES, knowledge(covariance), 1.0) / PROFILE_SHARE
    for axle, limit in zip(AXLES, LIMIT, strict=True):
        points = sigma_points(THETA, covariance, axle, 1.0)[list(axle)]
        used = lateral_shape(THETA[list(axle)][:, None])[:, 0] <= share * THETA[axle[2]]
        first = int(np.argmin(used)) if not used.all() else len(used)
        assert lateral_shape(points)[:first].max() <= limit + 1e-9


def test_grip_is_the_share_of_the_mean_peak() -> None:
    k = knowledge(np.zeros((7, 7)))
    assert usable_grip(AXLES, k, 1.0) == pytest.approx(usable_share(AXLES, k, 1.0) * (THETA[3] + THETA[6]) / 2)
