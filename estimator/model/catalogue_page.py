"""`docs/effects.md`, generated from the catalogue: `python -m estimator.model.catalogue_page > docs/effects.md`."""

from __future__ import annotations

import re

from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter

HEAD = """# Catalogue of effects

Generated from `estimator/model/effects/` (`python -m estimator.model.catalogue_page > docs/effects.md`). Each effect
is one file that identification, diagnosis and planner share; at its neutral parameters it changes nothing.

| effect | what the declared model lacks | equation | told from its look-alikes by |
| --- | --- | --- | --- |
"""
PARAMETERS = """
## Parameters

Outside its plausible range an effect is not named; the fit's own bounds are wider.

| effect | parameter | unit | neutral | prior std | meaning | plausible |
| --- | --- | --- | --- | --- | --- | --- |
"""
NOTES = """
Profiles are periodic cubic splines over the named signal. Effects with memory use the past of the signals on recorded
data and their first-order form in the planner.

## Sources

"""


def page() -> str:
    """The whole page."""
    effects = list(catalogue().values())
    rows = [_row(effect) for effect in effects]
    parameters = [_parameter(f"`{e.name}`" if i == 0 else "", p) for e in effects for i, p in enumerate(e.parameters)]
    return (
        HEAD + "\n".join(rows) + "\n" + PARAMETERS + "\n".join(parameters) + "\n" + NOTES
        + "\n".join(_sources(effects)) + "\n"
    )  # fmt: skip


def _row(effect: Effect) -> str:
    equation = effect.equation.replace("|", "\\|")
    return f"| `{effect.name}` | {effect.lacks}{_notes(effect)} | {equation} | {effect.separated_by} |"


def _notes(effect: Effect) -> str:
    """What else a reader has to know, in words."""
    notes = [f"profile over `{effect.profile}`"] if effect.profile else []
    notes += ["with memory"] if effect.prepare else []
    notes += [f"only with {' or '.join(f'`{n}`' for n in effect.requires_any)}"] if effect.requires_any else []
    return f" ({'; '.join(notes)})" if notes else ""


def _parameter(effect: str, p: Parameter) -> str:
    return f"| {effect} | `{p.name}` | {p.unit} | {p.prior:g} | {p.prior_std:g} | {p.description} | {_plausible(p)} |"


def _plausible(p: Parameter) -> str:
    if p.plausible is None:
        return f"{p.lower:g} to {p.upper:g}, the bounds"
    least = f", off neutral by {p.plausible.least:g}" if p.plausible.least else ""
    return f"{p.plausible.lower:g} to {p.plausible.upper:g}{least}: {p.plausible.reason}"


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
