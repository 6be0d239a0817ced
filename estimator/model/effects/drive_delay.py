"""Drive delay: the true actuation lags the reported one."""

from __future__ import annotations

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.memory import input_delay
from estimator.model.parameters import Parameter, Plausible, Quantity
from hil_gateway.car.car import Car

HOOK, PREPARE = input_delay("drive")


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    return (DeclaredParameter(car.actuators.force_delay, car.std("actuators.force_delay")),)


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
            quantity=Quantity.DRIVE_DELAY,
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
    declare=_declare,
)
