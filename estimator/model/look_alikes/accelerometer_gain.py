"""Accelerometers whose gain is off: to forces along and across the car they add what follows these forces."""

from __future__ import annotations

from estimator.model.effect import Effect, Hook
from estimator.model.effects.imu_misalignment import EFFECT as IMU_MISALIGNMENT
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

GAIN = Parameter(
    "gain",
    "1",
    1.0,
    0.05,
    0.5,
    2.0,
    "reported over true specific force",
    Plausible(0.8, 1.25, "a calibrated sensor is good to 1 %, a wrong scale of a cheap one to 10 %", 0.01),
)


def _along(terms: Terms, gain: Expr) -> None:
    terms.imu_ax = gain * terms.imu_ax


def _across(terms: Terms, gain: Expr) -> None:
    terms.imu_ay = gain * terms.imu_ay


def _gain(axis: str, which: str, velocity: str, hook: Hook) -> Effect:
    """Of the accelerometer of one axis, "ax" or "ay"."""
    return Effect(
        name=f"{axis}_gain",
        form_of=IMU_MISALIGNMENT,
        lacks=f"the gain of the {which} accelerometer is off",
        equation=f"{axis}_imu = k {axis}",
        source="definition",
        parameters=(GAIN,),
        channels=(axis,),
        cause=axis,
        hooks={"SENSOR": hook},
        separated_by=f"d/dt {velocity}, which does not change",
    )


AX_GAIN = _gain("ax", "longitudinal", "vx", _along)
AY_GAIN = _gain("ay", "lateral", "vy", _across)
