"""Time by which the reported steering leads or lags the other channels: known no better than a sample.

A log says when a row was written, not when within the sample each channel was taken. A millisecond moves the front
axle's B by most of a percent, so it is estimated along with the tyres, with half a sample as its prior.
"""

from __future__ import annotations

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr

NAME = "steer_timing"


def _input(terms: Terms, tau: Expr) -> None:
    terms.steer = terms.steer - tau * terms.aux["steer_rate"]


def steer_timing(step: float) -> Effect:
    """Delay of the road wheels behind the reported angle, s, for a log sampled every `step` s."""
    parameter = Parameter(f"{NAME}.tau", "s", 0.0, 0.5 * step, -3.0 * step, 3.0 * step, "delay behind the report")
    return Effect(
        name=NAME,
        equation="steer(t) = reported(t) - tau d/dt reported",
        source="first order of a pure delay",
        parameters=(parameter,),
        channels=("ay", "yaw_acc", "vy_dot"),
        lacks="the reported angle is sampled at the same instant as the states",
        hooks={"INPUT": _input},
        needs=("steer_rate",),
    )
