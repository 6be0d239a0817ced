"""Axle loads on a banked road: gravity and centripetal acceleration across it.

Always fitted with a bank and never named: how much of it reaches the tyres is for the data to say.
"""

from __future__ import annotations

from collections.abc import Collection

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.effects import effect_with
from estimator.model.parameters import Parameter, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr


def bank_load(terms: Terms, share: Expr) -> None:
    """Loads of both axles with what the bank `terms.bank` adds, times `share`."""
    across = terms.vx * terms.yaw_rate * ca.tan(terms.bank)
    change = share * (ca.cos(terms.bank) - 1.0 - across / GRAVITY)
    terms.load_f = terms.load_f + terms.vehicle.static_load_front * change
    terms.load_r = terms.load_r + terms.vehicle.static_load_rear * change


ROAD_LOAD = Effect(
    name="road_bank_load",
    lacks="axle loads from the bank",
    equation="F_z,i = F_z0,i (1 + k (cos(phi) - v_x w tan(phi) / g - 1)), k = 1 for a point mass on the road",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 9 (banking)",
    parameters=(Parameter("share", "1", 1.0, 0.5, 0.0, 1.2, "of the load that the bank adds"),),
    channels=(),
    hooks={"LOAD": bank_load},
)


def road_load(names: Collection[str], signals: Collection[str]) -> tuple[Effect, ...]:
    """The nuisance where a bank is among the effects, and no accelerometer among the signals tells the load."""
    return (ROAD_LOAD,) if effect_with(Quantity.BANK).name in names and "extra_load" not in signals else ()
