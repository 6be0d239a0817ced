"""Drive lag: the true drive command follows the reported one as a first-order system does."""

from __future__ import annotations

from estimator.model.effect import NOT_DRIVEN_WITH, Effect
from estimator.model.effects.drive_delay import EFFECT as DRIVE_DELAY
from estimator.model.memory import input_lag
from estimator.model.parameters import Parameter, Plausible, Quantity

HOOK, PREPARE = input_lag("drive")

EFFECT = Effect(
    name="drive_lag",
    form_of=DRIVE_DELAY,
    lacks="true drive command follows the reported one as a first-order system",
    equation="T d(d)/dt = d_reported - d",
    source="definition",
    parameters=(
        Parameter(
            "time_constant",
            "s",
            0.0,
            0.05,
            0.0,
            0.5,
            "time constant T of engine or brakes",
            Plausible(0.0, 0.45, "actuators and engine: 0.05 to 0.3 s; tyres relax in 0.5 m, 0.03 s at 15 m/s", 0.04),
            quantity=Quantity.DRIVE_DELAY,
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="drive_rate",
    hooks={"INPUT": HOOK},
    prepare=PREPARE,
    lags=True,
    unsought_while_driving=NOT_DRIVEN_WITH,
    initial=(0.05,),
    remembers=("drive_behind",),
    separated_by="fast changes of throttle or brake: a lag rounds their edges, a delay moves them",
)
