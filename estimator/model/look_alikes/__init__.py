"""What resembles an effect of the catalogue and is none: candidates, so that the effect is not named for it.

What is found of them is told as unexplained, with its numbers: they are laws of one cause, not parts of a car that the
planner would drive with.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effects.base import Effect
from estimator.model.look_alikes.steer_swing import STEER_SWING
from estimator.model.look_alikes.tyre_heat import TYRE_HEAT

LOOK_ALIKES: Mapping[str, Effect] = {effect.name: effect for effect in (STEER_SWING, TYRE_HEAT)}
"""Candidates by name; each is a form of the effect that it resembles."""
