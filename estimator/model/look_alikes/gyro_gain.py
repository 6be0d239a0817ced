"""A gyroscope whose gain is off: to tyres it is another steering ratio, and the heading shows that it is not."""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.effects.steer_scale import EFFECT as STEER_SCALE
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _input(terms: Terms, gain: Expr) -> None:
    terms.yaw_rate = terms.yaw_rate / gain


def _sensor(terms: Terms, gain: Expr) -> None:
    terms.yaw_acc = gain * terms.yaw_acc


GYRO_GAIN = Effect(
    name="gyro_gain",
    form_of=STEER_SCALE,
    lacks="the gyroscope's gain is off",
    equation="w_reported = k w",
    source="definition",
    parameters=(
        Parameter(
            "gain",
            "1",
            1.0,
            0.03,
            0.7,
            1.4,
            "reported over true yaw rate",
            Plausible(0.85, 1.15, "gyroscopes are good to 1 %, a wrong scale of a cheap one to 10 %", 0.005),
            quantity=Quantity.GYROSCOPE_GAIN,
        ),
    ),
    channels=("yaw_acc", "vy_dot"),
    cause="yaw_rate",
    hooks={"INPUT": _input, "SENSOR": _sensor},
    needs=("yaw",),
    separated_by="the heading of a whole lap against the integral of the yaw rate",
)
