"""The catalogue of effects as a person reads it: `hil diagnose --effects`."""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.effects import catalogue, effect_with
from estimator.model.look_alikes import LOOK_ALIKES
from estimator.model.parameters import Parameter

HEAD = """At its neutral parameters an effect changes nothing. Those with memory use the past of the signals on recorded
data, and their first-order form in the planner.
"""


def catalogue_text() -> str:
    """Every effect with its equation, its parameters, its source and what tells it apart."""
    lines = [line for effect in catalogue().values() for line in _described(effect)]
    alike = [f"{e.name}: {e.lacks}; resembles {e.id}, told by: {e.separated_by}" for e in LOOK_ALIKES.values()]
    return "\n".join([HEAD, *lines, "", "Look-alikes, which are never named as an effect:", *alike])


def _described(e: Effect) -> list[str]:
    return [
        f"{e.name}: {e.lacks}{_notes(e)}",
        f"  {e.equation}",
        *map(_parameter, e.parameters),
        f"  told by: {e.separated_by}",
        f"  source: {e.source}",
    ]


def _notes(effect: Effect) -> str:
    """What else a reader has to know, in words."""
    notes = [f"profile over {effect.profile}"] if effect.profile else []
    notes += ["with memory"] if effect.prepare else []
    notes += [f"reported as {effect.id}"] if effect.form_of else []
    others = [effect_with(quantity).name for quantity in effect.requires_any]
    notes += [f"only with {' or '.join(others)}"] if others else []
    return f" ({'; '.join(notes)})" if notes else ""


def _parameter(p: Parameter) -> str:
    unit = "" if p.unit == "1" else f", {p.unit}"
    return f"  {p.name}{unit}: {p.description}; {_plausible(p)}; neutral {p.prior:g}, prior std {p.prior_std:g}"


def _plausible(p: Parameter) -> str:
    if p.plausible is None:
        return f"{p.lower:g} to {p.upper:g} (bounds of the fit)"
    least = f", at least {p.plausible.least:g} off neutral" if p.plausible.least else ""
    return f"{p.plausible.lower:g} to {p.plausible.upper:g}{least} ({p.plausible.reason})"
