"""A drive force that is bent over its command: at small commands it lacks what rolling resistance would take.

Braking has a gain of its own, as front brakes would give it.
"""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import Effect, smooth_negative_part
from estimator.model.effects.rolling_resistance import EFFECT as ROLLING_RESISTANCE
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

SMOOTHING = 1e-4
"""The change from braking to driving is smooth within about this slip command."""
REFERENCE = 0.03
"""Slip command at which the bent force is that of the straight line."""


def _input(terms: Terms, exponent: Expr, gain: Expr) -> None:
    braking = smooth_negative_part(terms.drive, SMOOTHING)
    pushing = terms.drive - braking
    bent = pushing * ca.exp(0.5 * exponent * ca.log((pushing * pushing + SMOOTHING**2) / REFERENCE**2))
    terms.drive = bent + gain * braking


DRIVE_CURVE = Effect(
    name="drive_curve",
    form_of=ROLLING_RESISTANCE,
    lacks="the drive force is bent over its command",
    equation="d = d_0 (d_reported / d_0)^(1 + p), d_0 = 0.03, driving; q d_reported, braking",
    source="Guzzella & Onder, Internal Combustion Engine Systems, ch. 2 (torque over throttle)",
    parameters=(
        Parameter(
            "exponent",
            "1",
            0.0,
            0.2,
            -0.8,
            2.0,
            "p of the power by which the force grows beyond proportion",
            Plausible(-0.6, 1.0, "pedal maps from square root to square", 0.03),
        ),
        Parameter("gain", "1", 1.0, 0.3, 0.1, 10.0, "braking over driving force per unit of slip command", tells=False),
    ),
    channels=("ax", "vx_dot"),
    cause="drive",
    hooks={"INPUT": _input},
    separated_by="steady driving at several commands, and coasting",
)
