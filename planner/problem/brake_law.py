"""How a plan splits braking between the axles: by the loads they carry, the grip of each, and what its brakes do.

Ideal distribution (Gillespie, Fundamentals of Vehicle Dynamics, ch. 3): each axle brakes in proportion to what its
tyres bear, with a margin that lets the front axle reach its limit first: a car whose rear axle locks turns round.
The law is one for the model a plan is made with, the speed profile and the command.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from hil_gateway.car.powertrain import Powertrain
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr

REAR_MARGIN = 1.1
"""of what the front axle uses of its grip, over what the rear axle does: the engine, which the law leaves out, brakes
the rear axle with a tenth of what its brakes do in a hard stop"""
SHARES = (0.2, 0.8)
"""front share of the brakes' force at equal pressures that a belief may have"""
MOST_MOVED = 0.9
"""of the static rear load that braking takes off at most: a car on its nose needs another model"""


@dataclass(frozen=True)
class BrakeLaw:
    """The law of one declared car; numbers or CasADi expressions."""

    vehicle: Vehicle
    powertrain: Powertrain

    def balance(self, vx: Expr, drive: Expr, ratio: Expr, extra_load: Expr) -> Expr:
        """Front minus rear pressure over their sum at speed `vx` (m/s) and command `drive` (slip ratio).

        `ratio` is that of the pressures over that of the axle loads (`pressure_ratio`), `extra_load` what crests, dips
        and banks add to the axle loads, over the weight.
        """
        v = self.vehicle
        static_front, static_rear = ((1.0 + extra_load) * load for load in (v.static_load_front, v.static_load_rear))
        # CasADi's serve numbers too, 10 us later
        least, most = (min, max) if isinstance(drive, float) else (ca.fmin, ca.fmax)
        braking = most(-self.powertrain.force_per_drive * drive, 0.0)
        moved = least(v.cg_height / v.wheelbase * braking, MOST_MOVED * static_rear)
        air = 0.5 * v.air_density * vx * vx
        front = ratio * (static_front - air * v.lift_area_front + moved)
        rear = static_rear - air * v.lift_area_rear - moved
        low, high = self.powertrain.balances
        return least(most((front - rear) / (front + rear), low), high)


def pressure_ratio(usable: tuple[float, float], share: float | None) -> float:
    """Front over rear pressure, for equal axle loads.

    `usable` is the force over axle load (front, rear) that may be asked for, `share` that of the front axle in the
    force of the brakes at equal pressures; None where the model knows no front brakes, and has no use for a ratio.
    """
    if share is None:
        return 1.0
    known = min(max(share, SHARES[0]), SHARES[1])
    return REAR_MARGIN * usable[0] / usable[1] * (1.0 - known) / known
