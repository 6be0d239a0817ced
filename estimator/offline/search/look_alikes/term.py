"""The term of wheels that swing about their steering axis: what a search has accepted, told as unexplained.

Among the candidates it keeps a delay from being named for it; a catalogue effect it is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from estimator.model.basis import Proportional
from estimator.model.effects.base import Effect
from estimator.model.steering_swing import STEER_SWING
from estimator.offline.search.empirical import Term
from estimator.offline.search.search import Search
from estimator.offline.search.trial import Setting


@dataclass(frozen=True)
class SwingTerm(Term):
    """Wheels that swing; the signal is the reported steering angle, of which the shape is known but for two numbers."""

    @property
    def label(self) -> str:
        """What it is, in words."""
        return "wheels that swing about their steering axis"

    @property
    def effect(self) -> Effect:
        """The term as an effect."""
        return STEER_SWING

    def added_to(self, setting: Setting) -> Setting:
        """The search with the swing always active, and neither it nor a delay in its place tried."""
        untried = setting.untried | {STEER_SWING.name, STEER_SWING.id}
        return replace(setting, extra=(*setting.extra, STEER_SWING), untried=untried)


def told_apart(found: Search) -> tuple[SwingTerm | None, Search]:
    """The swing that a search has accepted, and the search with all else."""
    name = STEER_SWING.name
    if name not in found.accepted:
        return None, found
    term = SwingTerm(name, "steer", Proportional("steer", 1), found.gains[name], found.final)
    checked = replace(found.checked, gains={n: gain for n, gain in found.gains.items() if n != name})
    accepted = tuple(n for n in found.accepted if n != name)
    return term, replace(found, accepted=accepted, checked=checked)
