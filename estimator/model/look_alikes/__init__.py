"""What resembles an effect of the catalogue and is none: candidates, so that the effect is not named for it.

What is found of them is told as unexplained, with its numbers: they are laws of one cause, not parts of a car that the
planner would drive with.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effect import Effect
from estimator.model.look_alikes.accelerometer_gain import AX_GAIN, AY_GAIN
from estimator.model.look_alikes.brake_drag import BRAKE_DRAG
from estimator.model.look_alikes.drive_curve import DRIVE_CURVE
from estimator.model.look_alikes.gyro_gain import GYRO_GAIN
from estimator.model.look_alikes.steer_swing import STEER_SWING
from estimator.model.look_alikes.stiffness_drift import STIFFNESS_DRIFT
from estimator.model.look_alikes.torque_steer import TORQUE_STEER
from estimator.model.look_alikes.torque_vectoring import TORQUE_VECTORING
from estimator.model.look_alikes.tyre_heat import TYRE_HEAT

LOOK_ALIKES: Mapping[str, Effect] = {
    effect.name: effect
    for effect in (
        AX_GAIN, AY_GAIN, BRAKE_DRAG, DRIVE_CURVE, GYRO_GAIN, STEER_SWING, STIFFNESS_DRIFT, TORQUE_STEER,
        TORQUE_VECTORING, TYRE_HEAT,
    )
}  # fmt: skip
"""Candidates by name; each is a form of the effect that it resembles."""
