"""Sampling time of the reported inputs: a logger holds or averages them, which shifts them by less than a sample.

Always fitted and never named: a delay is an effect only when it exceeds what sampling explains.
"""

from __future__ import annotations

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _steer(terms: Terms, delay: Expr) -> None:
    terms.steer = terms.steer - delay * terms.auxiliary("steer_rate")


def _drive(terms: Terms, delay: Expr) -> None:
    terms.drive = terms.drive - delay * terms.auxiliary("drive_rate")


SAMPLED = {"steer_delay": _steer, "drive_delay": _drive}
"""Delays that sampling can be mistaken for, with the shift of the signal as a nuisance."""


def sampling_effects(step: float, delays: frozenset[str]) -> tuple[Effect, ...]:
    """Nuisance shifts of up to one sample of steer and drive, but for the signal whose delay is being tried."""
    return tuple(
        Effect(
            name=f"{name}_within_a_sample",
            lacks="sampling time of the reported input",
            equation="u(t) = u_reported(t) - T du/dt, |T| at most one sample",
            source="definition",
            parameters=(Parameter("delay", "s", 0.0, 0.3 * step, -step, step, "sampling time"),),
            channels=(),
            hooks={"INPUT": hook},
        )
        for name, hook in SAMPLED.items()
        if name not in delays
    )
