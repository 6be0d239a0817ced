"""Accelerometers whose gain is off: to forces along and across the car they add what follows these forces."""

from __future__ import annotations

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

PLAUSIBLE = Plausible(0.8, 1.25, "a calibrated sensor is good to 1 %, a wrong scale of a cheap one to 10 %", 0.01)


def _along(terms: Terms, gain: Expr) -> None:
    terms.imu_ax = gain * terms.imu_ax


def _across(terms: Terms, gain: Expr) -> None:
    terms.imu_ay = gain * terms.imu_ay


AX_GAIN = Effect(
    name="ax_gain",
    form_of="imu_misalignment",
    lacks="the gain of the longitudinal accelerometer is off",
    equation="a_x,imu = k a_x",
    source="definition",
    parameters=(Parameter("gain", "1", 1.0, 0.05, 0.5, 2.0, "reported over true specific force", PLAUSIBLE),),
    channels=("ax",),
    cause="ax",
    hooks={"SENSOR": _along},
    separated_by="d/dt vx, which does not change",
)
AY_GAIN = Effect(
    name="ay_gain",
    form_of="imu_misalignment",
    lacks="the gain of the lateral accelerometer is off",
    equation="a_y,imu = k a_y",
    source="definition",
    parameters=(Parameter("gain", "1", 1.0, 0.05, 0.5, 2.0, "reported over true specific force", PLAUSIBLE),),
    channels=("ay",),
    cause="ay",
    hooks={"SENSOR": _across},
    separated_by="d/dt vy, which does not change",
)
