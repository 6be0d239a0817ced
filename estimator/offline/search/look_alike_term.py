"""The term of a look-alike that a search has accepted: always active from then on, told as unexplained.

Among the candidates it keeps the effect that it resembles from being named for it; a catalogue effect it is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from estimator.model.basis import Proportional
from estimator.model.effect import Effect
from estimator.model.look_alikes import LOOK_ALIKES
from estimator.offline.search.empirical import Term
from estimator.offline.search.search import Search
from estimator.offline.search.trial import Setting


@dataclass(frozen=True)
class LookAlikeTerm(Term):
    """A look-alike by the name that is its place; its signal is its cause, its coefficients are its parameters."""

    @classmethod
    def of(cls, name: str, found: Search) -> LookAlikeTerm:
        """The term of a look-alike that a search has accepted."""
        cause = LOOK_ALIKES[name].cause
        return cls(name, cause, Proportional(cause, 1), found.gains[name], found.final)

    @property
    def label(self) -> str:
        """What it is, in words."""
        return self.effect.lacks

    @property
    def effect(self) -> Effect:
        """The term as an effect."""
        return LOOK_ALIKES[self.place]

    def added_to(self, setting: Setting) -> Setting:
        """The search with it always active, and neither it nor the effect that it resembles tried."""
        untried = setting.untried | {self.effect.name, self.effect.id}
        return replace(setting, extra=(*setting.extra, self.effect), untried=untried)


def split_look_alikes(found: Search) -> tuple[tuple[LookAlikeTerm, ...], Search]:
    """The look-alikes that a search has accepted, and the search with all else."""
    terms = tuple(LookAlikeTerm.of(name, found) for name in found.accepted if name in LOOK_ALIKES)
    checked = replace(found.checked, gains={n: gain for n, gain in found.gains.items() if n not in LOOK_ALIKES})
    accepted = tuple(n for n in found.accepted if n not in LOOK_ALIKES)
    return terms, replace(found, accepted=accepted, checked=checked)
