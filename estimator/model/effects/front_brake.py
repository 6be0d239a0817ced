"""Front brakes: part of the braking force acts on the front axle, and braking has a gain of its own.

Where the balance b of the pressures is reported, (p_f - p_r) / (p_f + p_r), axles share the force as their pressures
times what each makes of it, and p is the share at equal pressures; elsewhere b is 0, and p that of the split there is.
"""

from __future__ import annotations

from estimator.model.effect import DeclaredParameter, Effect, braking_force
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    """The gain is that of the brakes' force per unit of command over the engine's, which do not know of each other: an
    engine that turns out weak says that it is larger, and nothing of the brakes."""
    share = DeclaredParameter(car.powertrain.brake_share_front, car.std("powertrain.brake_share_front"))
    return share, DeclaredParameter(1.0, car.relative_std("powertrain.brake_force_per_pa"), over="cx")


def _longitudinal(terms: Terms, share: Expr, gain: Expr) -> None:
    braking = braking_force(terms.fx_r, terms.vehicle)
    balance = terms.auxiliary("brake_balance")
    front = (1.0 + balance) * share / (1.0 + balance * (2.0 * share - 1.0))
    terms.fx_f = terms.fx_f + front * gain * braking
    terms.fx_r = terms.fx_r + ((1.0 - front) * gain - 1.0) * braking


EFFECT = Effect(
    name="front_brake",
    lacks="part of the braking force acts on the front axle",
    equation="F_x,f = s q C_x min(d, 0); F_x,r = C_x max(d, 0) + (1 - s) q C_x min(d, 0); "
    "s = p (1 + b) / (1 + b (2 p - 1))",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 3 (brake proportioning)",
    parameters=(
        Parameter(
            "share",
            "1",
            0.0,
            0.3,
            0.0,
            1.0,
            "part of the braking force on the front axle, at equal pressures",
            Plausible(0.0, 0.95, "brake balance 0.5 to 0.65"),
            quantity=Quantity.FRONT_BRAKE_SHARE,
        ),
        Parameter(
            "gain",
            "1",
            1.0,
            0.5,
            0.1,
            10.0,
            "braking over driving force per unit of slip command",
            Plausible(0.15, 6.0, "brakes and engine share a scale of the command"),
            tells=False,
            quantity=Quantity.BRAKE_GAIN,
        ),
    ),
    channels=("ax", "ay", "yaw_acc", "vx_dot", "vy_dot"),
    cause="drive",
    hooks={"LONGITUDINAL": _longitudinal},
    separated_by="braking while turning: the front force then has a lateral component",
    on_every_car=True,
    declare=_declare,
)
