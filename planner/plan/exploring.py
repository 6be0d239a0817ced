"""How the planner explores where it is asked to: one set of settings for the learning campaign and the safety laps."""

from __future__ import annotations

from typing import Any

from hil_gateway.config import Config

EXPLORING: dict[str, Any] = {
    # at 60 plans that explore outgrow what an iteration follows: 2 of 280 are refused on the model's own car, at 30 one
    "information_weight": 3.0,
    "information_criterion": "log_det",
    "information_bound": 1000.0,
    # IMU measurements do not separate over the axles: the exact Hessian, projected
    "convexification": "projection",
}
"""section `planner` of the configuration; chosen on cars of the campaign that its report leaves out"""


def exploring(config: Config, **changes: Any) -> Config:
    """`config` with `EXPLORING` and `changes` in its planner section."""
    return config.model_copy(update={"planner": config.planner.model_copy(update={**EXPLORING, **changes})})
