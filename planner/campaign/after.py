"""What learning was good for: the plain planner with the learnt model against the same one with the declared model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from planner.campaign.analysis import bootstrap
from planner.campaign.trial import AFTERWARDS, Learnt


def learnt_by(result: Mapping[str, Any]) -> Learnt:
    """What a drive ended with, from its stored result."""
    return Learnt(**{**result["learnt"], "limits": tuple(result["learnt"]["limits"])})


def compare(results: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Lap times and margins with the declared and with the learnt model over all cars that drove both.

    None where no car did.
    """
    drives = {(r["trial"]["method"], r["trial"]["seed"]): r for r in results if r["trial"]["method"] in AFTERWARDS}
    seeds = sorted(s for m, s in drives if m == "prior" and ("learnt", s) in drives)
    if not seeds:
        return None
    gain = [100.0 * (1.0 - _lap(drives["learnt", s]) / _lap(drives["prior", s])) for s in seeds]
    return {
        "seeds": len(seeds),
        "faster_percent": vars(bootstrap(gain)),
        "slower_cars": sum(g <= 0.0 for g in gain),
        **{method: _figures([drives[method, s] for s in seeds]) for method in AFTERWARDS},
    }


def _lap(result: Mapping[str, Any]) -> float:
    """Mean lap time, s; a drive that finished none counts as endlessly slow."""
    laps = result["lap_times_s"]
    return sum(laps) / len(laps) if laps else float("inf")


def _figures(drives: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    safety = [d["safety"] for d in drives]
    return {
        "lap_time_s": vars(bootstrap([_lap(d) for d in drives])),
        "worst_margin_m": min(s["worst_margin_m"] for s in safety),
        "margin_m": vars(bootstrap([s["worst_margin_m"] for s in safety])),
        "worst_slip_share": max(s["worst_slip_share"] for s in safety),
        "violations": {
            "track": sum(s["off_track"] for s in safety),
            "load": sum(s["load_violations"] for s in safety),
            "traction": sum(s["traction_lost"] for s in safety),
        },
    }
