"""What a log's sensors add to the model: parameters that are estimated along with the tyres but are not of the car.

Left out, they would be taken for tyre parameters. Each is an `Effect` with a prior, so every fit can carry it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.effects import effect_with
from estimator.model.parameters import Parameter, Quantity
from estimator.model.single_track import Terms
from estimator.offline.record.road_load import bank_load
from estimator.offline.record.unknown_inputs import DISPLACED_VY
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr

STEER_TIMING = "steer_timing"
YAW_RATE_TIMING = "yaw_rate_timing"
KNOWN_BANK = "known_bank"


def _delayed(terms: Terms, tau: Expr) -> None:
    terms.steer = terms.steer - tau * terms.aux["steer_rate"]


def steer_timing(step: float) -> Effect:
    """Delay of the road wheels behind the reported angle, s, for a log sampled every `step` s.

    A log says when a row was written, not when within the sample each channel was taken. A millisecond moves the
    front axle's B by most of a percent, so the delay is estimated; servos delay by tens of milliseconds.
    """
    spread = max(0.5 * step, 0.03)
    parameter = Parameter(f"{STEER_TIMING}.tau", "s", 0.0, spread, -5.0 * spread, 5.0 * spread, "delay")
    return Effect(
        name=STEER_TIMING,
        lacks="the reported angle is sampled at the same instant as the states",
        equation="steer(t) = reported(t) - tau d/dt reported",
        source="first order of a pure delay",
        parameters=(parameter,),
        channels=("ay", "yaw_acc", "vy_dot"),
        hooks={"INPUT": _delayed},
        needs=("steer_rate",),
    )


def steer_zero() -> Effect:
    """Offset of the reported angle, rad: a steering that reads zero a degree off bends one side's tyre curve."""
    return along(effect_with(Quantity.STEER_ZERO))


def along(effect: Effect) -> Effect:
    """An effect with parameters named `effect.parameter`."""
    parameters = tuple(replace(p, name=f"{effect.name}.{p.name}") for p in effect.parameters)
    return replace(effect, parameters=parameters)


def vy_sensor() -> Effect:
    """Sensor of vy ahead of the CoG, turned against the car, with a bias: used where log health finds it so.

    Where vy is simulated it is no input, and what the sensor makes of it is an output (`reported_vy`).
    """
    return replace(along(DISPLACED_VY), hooks={})


def yaw_rate_timing() -> Effect:
    """What is left of the yaw rate's lag after log health has re-aligned it."""
    return Effect(
        name=YAW_RATE_TIMING,
        lacks="yaw rate is recorded when it happens",
        equation="yaw_rate reported = yaw_rate - tau yaw_acc",
        source="first order of a pure delay",
        parameters=(Parameter(f"{YAW_RATE_TIMING}.tau", "s", 0.0, 0.05, -0.2, 0.2, "delay"),),
        channels=(),
        hooks={},
    )


def _banked(terms: Terms, share: Expr, zero: Expr) -> None:
    terms.bank = terms.aux[KNOWN_BANK] + zero


def _loaded(terms: Terms, share: Expr, zero: Expr) -> None:
    bank_load(terms, share)


def _pulled(terms: Terms, share: Expr, zero: Expr) -> None:
    terms.gravity_y = terms.gravity_y - GRAVITY * ca.sin(terms.bank)


def _as_derived(terms: Terms, share: Expr, zero: Expr) -> None:
    terms.imu_ay = terms.imu_ay + GRAVITY * (ca.sin(terms.aux[KNOWN_BANK]) - ca.sin(terms.bank))


def known_bank(*, ay_is_derived: bool) -> Effect:
    """Bank that the log shows before any tyre is fitted: gravity across the car, and so much of the axle loads.

    A roll channel has a zero, and so has an accelerometer: only the tyres tell how level the straights are. An ay that
    was derived from velocities has the bank in it as it was found.
    """
    derived = {"SENSOR": _as_derived} if ay_is_derived else {}
    return Effect(
        name=KNOWN_BANK,
        lacks="the road is level across the car",
        equation="d/dt vy + vx w - ay = -g sin(bank + zero), axle loads as in `road_load`",
        source="Rajamani, Vehicle Dynamics and Control, eq. 2.40",
        parameters=(
            Parameter(f"{KNOWN_BANK}.share", "1", 1.0, 0.25, 0.0, 1.2, "of the load that the bank adds"),
            Parameter(f"{KNOWN_BANK}.zero", "rad", 0.0, 0.02, -0.1, 0.1, "bank less the one found, everywhere"),
        ),
        channels=("ay", "yaw_acc", "vy_dot"),
        hooks={"INPUT": _banked, "LOAD": _loaded, "MOTION": _pulled, **derived},
        needs=(KNOWN_BANK,),
    )


def reported_vy(vx: Expr, vy: Expr, yaw_rate: Expr, sensor: Sequence[Expr]) -> Expr:
    """What a sensor of vy reports, m/s; `sensor`: distance ahead of the CoG, misalignment, bias."""
    x, angle, bias = sensor
    return vy + x * yaw_rate + angle * vx + bias
