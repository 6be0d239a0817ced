"""Drive delay: the true actuation lags the reported one."""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.memory import input_delay
from estimator.model.parameters import Parameter, Plausible

HOOK, PREPARE = input_delay("drive")

EFFECT = Effect(
    name="drive_delay",
    lacks="true drive command lags the reported one",
    equation="d(t) = d_reported(t - T)",
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
            Plausible(0.0, 0.45, "actuators, engine and buses: 0.05 to 0.3 s"),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="drive_rate",
    hooks={"INPUT": HOOK},
    prepare=PREPARE,
    lags=True,
    shifts="drive",
    initial=(0.05,),
    remembers=("drive_shift",),
    separated_by="fast changes of throttle or brake",
)
