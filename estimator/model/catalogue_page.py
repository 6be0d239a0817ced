"""`docs/effects.md`, generated from the catalogue: `python -m estimator.model.catalogue_page > docs/effects.md`."""

from __future__ import annotations

import math

from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter

HEAD = """# Catalogue of effects

Generated from `estimator/model/effects/` (`python -m estimator.model.catalogue_page > docs/effects.md`). Each effect
is one file that identification, diagnosis and planner share. At its neutral parameters the declared model is as it was.

| effect | what the declared model lacks | equation | told from its look-alikes by |
| --- | --- | --- | --- |
"""
PARAMETERS = """
## Parameters

| effect | parameter | unit | neutral | prior std | bounds | meaning | plausible |
| --- | --- | --- | --- | --- | --- | --- | --- |
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
    parameters = [_parameter(effect, p) for effect in effects for p in effect.parameters]
    sources = sorted({effect.source for effect in effects})
    return (
        HEAD + "\n".join(rows) + "\n" + PARAMETERS + "\n".join(parameters) + "\n" + NOTES
        + "\n".join(f"- {source}: {_of(source, effects)}" for source in sources) + "\n"
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


def _parameter(effect: Effect, p: Parameter) -> str:
    low, high = (f"{v:g}" if math.isfinite(v) else "none" for v in (p.lower, p.upper))
    numbers = f"{p.prior:g} | {p.prior_std:g} | {low} to {high}"
    return f"| `{effect.name}` | `{p.name}` | {p.unit} | {numbers} | {p.description} | {_plausible(p)} |"


def _plausible(p: Parameter) -> str:
    if p.plausible is None:
        return "within the bounds"
    least = f", off neutral by {p.plausible.least:g}" if p.plausible.least else ""
    return f"{p.plausible.lower:g} to {p.plausible.upper:g}{least}: {p.plausible.reason}"


def _of(source: str, effects: list[Effect]) -> str:
    return ", ".join(f"`{effect.name}`" for effect in effects if effect.source == source)


if __name__ == "__main__":
    print(page(), end="")
