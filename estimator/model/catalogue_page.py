"""`docs/effects.md`, generated from the catalogue: `python -m estimator.model.catalogue_page > docs/effects.md`."""

from __future__ import annotations

import math

from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter

HEAD = """# Catalogue of effects

Generated from `estimator/model/effects/` (`python -m estimator.model.catalogue_page > docs/effects.md`).

Each effect is one small file: its physics in one equation with its source, its parameters with unit, prior and bounds,
the residual channels it acts on, and the stages of the single-track model it hooks into. The same CasADi expression
is used by identification, diagnosis and planner. At its neutral parameters an effect leaves the declared model exactly
as it was. To add one, add a file that defines `EFFECT`.
"""


def page() -> str:
    """The whole page."""
    return "\n".join([HEAD, *(_section(effect) for effect in catalogue().values())])


def _section(effect: Effect) -> str:
    lines = [
        f"## `{effect.name}`", "", f"What the declared model lacks: {effect.lacks}.", "",
        f"    {effect.equation}", "", f"Source: {effect.source}. Channels: {', '.join(effect.channels)}. "
        f"Stages: {', '.join(effect.hooks)}.", "",
        "| parameter | unit | neutral | prior std | bounds | meaning | plausible |", f"|{7 * ' --- |'}",
        *(_row(p) for p in effect.parameters), "",
    ]  # fmt: skip
    if effect.profile:
        lines += [f"The parameter is a periodic cubic spline over `{effect.profile}`.", ""]
    if effect.prepare:
        text = "Has memory: on recorded data it uses the past of the signals, in the planner its first-order form."
        lines += [text, ""]
    if effect.requires_any:
        lines += [f"Shows only together with {' or '.join(f'`{n}`' for n in effect.requires_any)}.", ""]
    if effect.separated_by:
        lines += [f"Told from its look-alikes by: {effect.separated_by}.", ""]
    return "\n".join(lines)


def _row(p: Parameter) -> str:
    low, high = (f"{v:g}" if math.isfinite(v) else "none" for v in (p.lower, p.upper))
    numbers = f"{p.prior:g} | {p.prior_std:g} | {low} to {high}"
    return f"| `{p.name}` | {p.unit} | {numbers} | {p.description} | {_plausible(p)} |"


def _plausible(p: Parameter) -> str:
    if p.plausible is None:
        return "within the bounds"
    return f"{p.plausible.lower:g} to {p.plausible.upper:g}: {p.plausible.reason}"


if __name__ == "__main__":
    print(page(), end="")
