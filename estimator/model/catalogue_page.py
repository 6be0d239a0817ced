"""`docs/effects.md`, generated from the catalogue: `python -m estimator.model.catalogue_page > docs/effects.md`."""

from __future__ import annotations

import re

from estimator.model.effect import Effect
from estimator.model.effects import catalogue, effect_with
from estimator.model.parameters import Parameter

HEAD = """# Catalogue of effects

For whoever reads a diagnosis. Generated from `estimator/model/effects/`
(`python -m estimator.model.catalogue_page > docs/effects.md`). Each effect is one file
that identification, diagnosis and planner share; at its neutral parameters it changes nothing.
`hil diagnose --effects` prints the parameters: unit, neutral value, prior, plausible range with its reason.

| effect | what the declared model lacks | equation | told from its look-alikes by |
| --- | --- | --- | --- |
"""
NOTES = """
Profiles are periodic cubic splines over the named signal. Effects with memory use the past of the signals on recorded
data and their first-order form in the planner; a late drive command is worked out from its past in both.

## Sources

"""


def page() -> str:
    """The whole page."""
    effects = list(catalogue().values())
    return HEAD + "\n".join(map(_row, effects)) + "\n" + NOTES + "\n".join(_sources(effects)) + "\n"


def parameter_list() -> str:
    """Every effect with its parameters, for a terminal."""
    return "\n".join(
        line for e in catalogue().values() for line in (f"{e.name}: {e.lacks}", *map(_parameter, e.parameters))
    )


def _row(effect: Effect) -> str:
    equation = effect.equation.replace("|", "\\|")
    return f"| `{effect.name}` | {effect.lacks}{_notes(effect)} | {equation} | {effect.separated_by} |"


def _notes(effect: Effect) -> str:
    """What else a reader has to know, in words."""
    notes = [f"profile over `{effect.profile}`"] if effect.profile else []
    notes += ["with memory"] if effect.prepare else []
    notes += [f"reported as `{effect.id}`"] if effect.form_of else []
    others = [f"`{effect_with(quantity).name}`" for quantity in effect.requires_any]
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


def _sources(effects: list[Effect]) -> list[str]:
    """One line a work, with the chapter or equation of every effect."""
    works: dict[str, dict[str, list[str]]] = {}
    for effect in sorted(effects, key=lambda e: e.source):
        work, *place = re.split(r", (?=ch\. |eq\. )", effect.source, maxsplit=1)
        works.setdefault(work, {}).setdefault("".join(place), []).append(f"`{effect.name}`")
    return [f"- {work}: {_places(places)}" for work, places in works.items()]


def _places(places: dict[str, list[str]]) -> str:
    return "; ".join(f"{place}: {', '.join(names)}".removeprefix(": ") for place, names in places.items())


if __name__ == "__main__":
    print(page(), end="")
