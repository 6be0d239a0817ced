"""What an effect is: physics hooked into stages of the single-track model, with its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from estimator.model.parameters import Parameter

Hook = Callable[..., None]
"""hook(terms, *parameters) changes the working set of the model in place."""


@dataclass(frozen=True)
class Effect:
    """One physical effect.

    `hooks` maps a stage name of `single_track.Stage` to its equation; `channels` are the residual channels it
    acts on; `needs` are auxiliary signals without which it cannot be evaluated.
    """

    name: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    hooks: Mapping[str, Hook]
    needs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        assert self.parameters, f"effect {self.name} has no parameters"

    def neutral(self) -> tuple[Any, ...]:
        """Parameter values at the prior mean."""
        return tuple(p.prior for p in self.parameters)
