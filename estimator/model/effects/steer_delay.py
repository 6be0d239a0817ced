"""Steer delay: the true road-wheel angle lags the reported one."""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.memory import input_delay
from estimator.model.parameters import Parameter, Plausible

HOOK, PREPARE = input_delay("steer")

EFFECT = Effect(
    name="steer_delay",
    lacks="true road-wheel angle lags the reported one",
    equation="delta(t) = delta_reported(t - T)",
    source="definition; first-order form by Taylor expansion",
    parameters=(
        Parameter(
            "delay",
            "s",
            0.0,
            0.05,
            0.0,
            0.5,
            "true actuation after the reported one",
            Plausible(0.0, 0.4, "actuators and buses: 0.02 to 0.2 s"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer_rate",
    hooks={"INPUT": HOOK},
    prepare=PREPARE,
    lags=True,
    shifts="steer",
    initial=(0.03,),
    remembers=("steer_shift",),
    separated_by="fast steering at different speeds: a delay is the same at any speed, relaxation shrinks with it",
)
