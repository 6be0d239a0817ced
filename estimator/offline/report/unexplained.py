"""What a diagnosis leaves unexplained: by channel, what it depends on, where it acts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimator.model.declared_vehicle import all_candidates, id_of
from estimator.model.single_track import CHANNELS
from estimator.offline.diagnosis import Diagnosis
from estimator.offline.predict.places import PLACES
from estimator.offline.report.words import (
    CHANNEL_NAMES,
    NAMES,
    describe,
    follows_turn_direction,
    grip_words,
    span_words,
)
from estimator.offline.result.leftover import Leftover
from estimator.offline.search.acceptance import BEYOND_NOISE
from estimator.offline.search.empirical import Term
from estimator.offline.search.look_alike_term import LookAlikeTerm
from estimator.offline.search.stretches.cells import Stretch
from estimator.offline.search.stretches.term import StretchTerm

NEARLY = 0.8
"""A signal whose term gains more than this share of the accepted one's is an alternative."""
SMALLEST_CHANNEL_SHARE = 0.1
"""A channel is named when the empirical term removes more than this of its squared residual."""


def unexplained(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Channels in which an empirical term is needed, strongest first, with what it depends on and where it acts.

    A term that hardly changes a channel says nothing of what is left there; one that leaves more than it explains comes
    after what is left, and what any other leaves comes last.
    """
    tried = [entry for term in diagnosis.terms for entry in _by_term(diagnosis, term)]
    tried += [entry for name in diagnosis.insignificant for entry in _by_insignificant(diagnosis, name)]
    tried.sort(key=lambda e: -float(e["share_of_residual"]))
    entries = [e for e in tried if e["share_of_residual"] > SMALLEST_CHANNEL_SHARE]
    left = sorted((_left(left) for left in diagnosis.leftover), key=lambda e: -float(e["share_of_residual"]))
    if not left:
        return entries or tried[:1]
    named = {e["channel"] for e in entries}
    first = [e for e in left if e["channel"] in named and _leaves_more(diagnosis.channels[e["channel"]])]
    return first + entries + [e for e in left if e not in first]


def _leaves_more(channel: Mapping[str, float]) -> bool:
    """Whether the empirical terms leave more of a channel beyond noise than they explain, by its errors."""
    before, after, floor = (channel[name] for name in ("catalogue", "with_effects", "noise_floor"))
    return before**2 - after**2 < after**2 - (BEYOND_NOISE * floor) ** 2


def _by_term(diagnosis: Diagnosis, term: Term) -> list[dict[str, Any]]:
    """What a term explains, for each channel that it acts on."""
    block = next(b for b in diagnosis.fit.predictor.blocks if b.effect.name == term.effect.name)
    coefficients = diagnosis.fit.parameters[block.parameters]
    if isinstance(term, StretchTerm):
        variance = np.diag(diagnosis.spread)[block.parameters]
        return _by_stretch(diagnosis, term, float(coefficients[0]), float(np.sqrt(variance[0])))
    if isinstance(term, LookAlikeTerm):
        numbers = zip(term.effect.parameters, coefficients, strict=True)
        sizes = ", ".join(f"{p.name} {value:.3g} {p.unit}".removesuffix(" 1") for p, value in numbers)
        what = f"{term.label} ({sizes})"
        return [_entry(diagnosis, term, channel, term.signal, what) for channel in term.effect.channels]
    values = diagnosis.record.signals[term.signal][diagnosis.record.rows].ravel()
    where, signal = describe(term.basis, values, coefficients), term.signal
    if follows_turn_direction(term.basis, values, coefficients):
        signal = "turn_direction"
    what = f"{PLACES[term.place].words} as a function of {NAMES.get(signal, signal)}; acts at {where}"
    return [_entry(diagnosis, term, channel, signal, what) for channel in term.effect.channels]


def _entry(diagnosis: Diagnosis, term: Term, channel: str, signal: str, what: str) -> dict[str, Any]:
    """What a term explains of a channel, by its errors on the scored laps."""
    before, after = (diagnosis.channels[channel][m] for m in ("catalogue", "with_effects"))
    return {
        "channel": channel, "signal": signal, "share_of_residual": round(max(0.0, 1.0 - (after / before) ** 2), 4),
        "description": f"{CHANNEL_NAMES[channel]}: {what}",
        "empirical": True, "term": term.effect.name, "alternatives": _other_causes(diagnosis, term),
    }  # fmt: skip


def _by_insignificant(diagnosis: Diagnosis, name: str) -> list[dict[str, Any]]:
    """What an effect whose size is not told from nothing would explain, for each channel; shares as of a stretch."""
    effect, gains = all_candidates()[name], diagnosis.gains[name].channels
    words = f"over {NAMES.get(effect.cause, effect.cause)}, as {id_of(name)} would, whose size is not told from nothing"
    return [
        {
            "channel": channel, "signal": effect.cause,
            "share_of_residual": _share(diagnosis, float(gains[CHANNELS.index(channel)])),
            "description": f"{CHANNEL_NAMES[channel]} {words}: its cause is not determined",
            "empirical": False, "term": name, "spans": [], "alternatives": [],
        }
        for channel in effect.channels
    ]  # fmt: skip


def _share(diagnosis: Diagnosis, gain: float) -> float:
    """Share of a channel's squared residual that a gain of log-likelihood is, on the laps learnt from."""
    count = float(diagnosis.fit.normal.count.sum())
    return round(1.0 - float(np.exp(-2.0 * max(0.0, gain) / count)), 4)


def _by_stretch(diagnosis: Diagnosis, term: StretchTerm, change: float, std: float) -> list[dict[str, Any]]:
    """Another grip on a stretch, for each channel; its share is of the laps learnt from, predicted by each other."""
    stretch, entries = term.stretch, []
    for channel in term.effect.channels:
        share = _share(diagnosis, float(term.evidence.channels[CHANNELS.index(channel)]))
        entries.append({
            "channel": channel, "signal": term.signal, "share_of_residual": share,
            "description": f"{CHANNEL_NAMES[channel]}: {grip_words(stretch, change, std)}",
            "empirical": True, "term": term.effect.name, "alternatives": _other_causes(diagnosis, term),
            **_of_stretch(stretch, change, std),
        })  # fmt: skip
    return entries


def _of_stretch(stretch: Stretch, change: float, std: float) -> dict[str, Any]:
    """Keys of an entry: place, laps (`every_lap`: those not learnt from as well), relative change of grip."""
    return {
        "spans": [[stretch.start, stretch.end]], "laps": list(stretch.laps), "every_lap": stretch.every_lap,
        "grip_change": {"value": change, "std": std},
    }  # fmt: skip


def _left(left: Leftover) -> dict[str, Any]:
    """A channel whose residual is more than noise, though no term earned its place."""
    laps = " in the scored laps only" if left.only_scored else ""
    size = f"{CHANNEL_NAMES[left.channel]}: {left.ratio:.2g} times the noise is left{laps}"
    entry = {"channel": left.channel, "signal": left.signal, "share_of_residual": round(left.share, 4)}
    rest = {"empirical": False, "spans": [list(span) for span in left.spans], "alternatives": []}
    if (grip := left.grip) is not None:
        words = f"{size}, most {grip_words(grip.stretch, grip.change, grip.std)}; no fit has it"
        return {**entry, "description": words, **rest, **_of_stretch(grip.stretch, grip.change, grip.std),
                "elsewhere": left.elsewhere}  # fmt: skip
    where = span_words(left.signal, left.spans, *left.reach)
    places = " and ".join(f"lap {lap} from {a:.0f} to {b:.0f} m" for lap, a, b in left.places)
    words = f"{size}, most at {where}{f' ({places})' if places else ''}"
    named = [{"lap": lap, "from": a, "to": b} for lap, a, b in left.places]
    return {**entry, "description": words, **rest, **({"places": named} if named else {})}


def _other_causes(diagnosis: Diagnosis, term: Term) -> list[dict[str, float | str]]:
    """Other signals on which a term explains nearly as much: the drive does not tell them apart."""
    others = [t for t in diagnosis.term_trials if t.fit and t.signal != term.signal]
    shares = {t.signal: t.evidence.gain / term.evidence.gain for t in reversed(others)}
    return [{"signal": n, "gain": round(g, 3)} for n, g in shares.items() if NEARLY < g < 1.0]
