"""What is not known of the inputs of a log: always fitted and never named.

When they were sampled: a logger holds or averages them, which shifts them by less than a sample; a delay is an effect
only when it exceeds that. And what a drive that was derived from pedals means: where the throttle begins to push, and
what the brake does in units of the throttle.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effect import VY_SENSOR, Effect, Hook, smooth_negative_part
from estimator.model.effects import catalogue
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _steer(terms: Terms, delay: Expr) -> None:
    terms.steer = terms.steer - delay * terms.auxiliary("steer_rate")


def _drive(terms: Terms, delay: Expr) -> None:
    terms.drive = terms.drive - delay * terms.auxiliary("drive_rate")


def _lateral(terms: Terms, delay: Expr) -> None:
    terms.imu_ay = terms.imu_ay - delay * (terms.vx * terms.yaw_acc + terms.vx_dot * terms.yaw_rate)


SAMPLED = {"steer": _steer, "drive": _drive}
"""Shift of an input as a nuisance: sampling can be mistaken for a delay."""
RESAMPLED_S = 0.015
"""s between rows from which a log holds older readings: inertial units report at 100 Hz"""


def sampling_effects(step: float, names: frozenset[str]) -> tuple[Effect, ...]:
    """Nuisance shifts of up to one sample of steer and drive, but for the signal whose delay is among `names`, and of
    the lateral accelerometer, which looks displaced by what the car travels in that time, in logs slower than it."""
    delayed = {effect.shifts for name, effect in catalogue().items() if name in names}
    inputs = [_shift(name, {"INPUT": hook}, step) for name, hook in SAMPLED.items() if name not in delayed]
    if step < RESAMPLED_S:
        return tuple(inputs)
    return (*inputs, _shift("ay", {"SENSOR": _lateral}, step))


def _shift(name: str, hooks: Mapping[str, Hook], step: float) -> Effect:
    return Effect(
        name=f"{name}_within_a_sample",
        lacks=f"sampling time of {name}",
        equation="u(t) = u_reported(t) - T du/dt, |T| at most one sample",
        source="definition",
        parameters=(Parameter("delay", "s", 0.0, 0.3 * step, -step, step, "sampling time"),),
        channels=(),
        hooks=hooks,
    )


PEDALS = "pedals"
NEAR_ZERO = 1e-3
"""drive command below which throttle passes into brake"""


def _pedals(terms: Terms, zero: Expr, brake: Expr) -> None:
    pressed = smooth_negative_part(terms.drive, NEAR_ZERO)
    terms.drive = terms.drive - zero + (brake - 1.0) * pressed


def pedal_effects(pedals: bool) -> tuple[Effect, ...]:
    """Zero of the throttle and scale of the brake, where `pedals` is what the drive was derived from.

    The zero is a constant force, as rolling resistance is: each is only as sure as the other is known.
    """
    if not pedals:
        return ()
    effect = Effect(
        name=PEDALS,
        lacks="zero and scales of the pedals",
        equation="d = d_throttle - d_0 + k d_brake",
        source="definition of a drive that is derived from pedals (`estimator.drive_log.derived`)",
        parameters=(
            Parameter("zero", "1", 0.0, 0.005, -0.03, 0.03, "drive at which the engine neither drives nor drags"),
            Parameter("brake", "1", 1.0, 0.5, 0.05, 5.0, "scale of the brake over that of the throttle"),
        ),
        channels=(),
        hooks={"INPUT": _pedals},
    )
    return (effect,)


def _at_the_centre(terms: Terms, x: Expr, angle: Expr, bias: Expr) -> None:
    terms.vy = terms.vy - x * terms.yaw_rate - angle * terms.vx - bias


def _at_its_sensor(terms: Terms, x: Expr, angle: Expr, bias: Expr) -> None:
    terms.vy_dot = terms.vy_dot + x * terms.yaw_acc + angle * terms.vx_dot


DISPLACED_VY = Effect(
    name=VY_SENSOR,
    lacks="vy is that of the centre of gravity",
    equation="vy_reported = vy + x omega + psi vx + b",
    source="rigid-body kinematics",
    parameters=(
        Parameter("x", "m", 0.0, 1.0, -5.0, 5.0, "position ahead of the centre of gravity"),
        Parameter("angle", "rad", 0.0, 0.02, -0.2, 0.2, "misalignment"),
        Parameter("bias", "m/s", 0.0, 0.1, -2.0, 2.0, "bias"),
    ),
    channels=(),
    hooks={"INPUT": _at_the_centre, "SENSOR": _at_its_sensor},
)


def vy_effects(displaced: bool) -> tuple[Effect, ...]:
    """What log health has left of the place, turn and bias of a sensor of vy that it corrected.

    It saw them through tyres without downforce, bank and load transfer.
    """
    return (DISPLACED_VY,) if displaced else ()
