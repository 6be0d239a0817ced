"""Steer lag: the true road-wheel angle follows the reported one as a first-order system does."""

from __future__ import annotations

from estimator.model.effect import NOT_DRIVEN_WITH, Effect
from estimator.model.effects.steer_delay import EFFECT as STEER_DELAY
from estimator.model.memory import input_lag
from estimator.model.parameters import Parameter, Plausible

HOOK, PREPARE = input_lag("steer")

EFFECT = Effect(
    name="steer_lag",
    form_of=STEER_DELAY,
    lacks="true road-wheel angle follows the reported one as a first-order system",
    equation="T d(delta)/dt = delta_reported - delta",
    source="definition",
    parameters=(
        Parameter(
            "time_constant",
            "s",
            0.0,
            0.05,
            0.0,
            0.5,
            "time constant T of the actuator",
            Plausible(0.0, 0.4, "actuators: 0.02 to 0.2 s"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer_rate",
    hooks={"INPUT": HOOK},
    prepare=PREPARE,
    lags=True,
    unsought_while_driving=NOT_DRIVEN_WITH,
    initial=(0.03,),
    remembers=("steer_behind",),
    separated_by="quick steering: a lag rounds its edges, a delay moves them",
)
