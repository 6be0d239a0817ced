"""What learning was good for: the plain planner with the learnt model against the same one with the declared model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.campaign.analysis import bootstrap
from benchmarks.campaign.trial import AFTERWARDS, Learnt


def learnt_by(result: Mapping[str, Any]) -> Learnt:
    """What a drive ended with, from its stored result."""
    return Learnt(**{**result["learnt"], "limits": tuple(result["learnt"]["limits"])})


def compare(results: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Lap times and margins with the declared and with the learnt model, over the cars that never left the track.

    A lap that leaves the track is no lap to compare with: such cars are named in `left_the_track`, by model. None where
    no car is left.
    """
    drives = {(r["trial"]["method"], r["trial"]["seed"]): r for r in results if r["trial"]["method"] in AFTERWARDS}
    both = sorted(s for m, s in drives if m == "prior" and ("learnt", s) in drives)
    left = {m: [s for s in both if drives[m, s]["safety"]["off_track"]] for m in AFTERWARDS}
    seeds = [s for s in both if not any(s in cars for cars in left.values())]
    if not seeds:
        return None
    gain = [100.0 * (1.0 - _lap(drives["learnt", s]) / _lap(drives["prior", s])) for s in seeds]
    return {
        "seeds": len(seeds),
        "left_the_track": left,
        "faster_percent": vars(bootstrap(gain)),
        "slower_cars": sum(g <= 0.0 for g in gain),
        "cars": {s: {m: _car(drives[m, s]) for m in AFTERWARDS} for s in both},
        **{method: _figures([drives[method, s] for s in seeds]) for method in AFTERWARDS},
    }


def _car(result: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("worst_margin_m", "worst_slip_share", "worst_true_load_share", "off_track", "load_violations")
    return {"lap_times_s": result["lap_times_s"], **{key: result["safety"][key] for key in keys}}


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
