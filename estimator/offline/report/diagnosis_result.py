"""A diagnosis as JSON and as a model revision."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from estimator.belief.revision import revision_id
from estimator.model.declared_vehicle import DECLARED, id_of
from estimator.model.parameters import Parameter
from estimator.model.single_track import CHANNELS
from estimator.offline.diagnosis import Diagnosis, alternatives
from estimator.offline.predict.predict import Block
from estimator.offline.report.unexplained import unexplained
from estimator.offline.result.diagnosis_score import HORIZON_S, LONG_HORIZON_S, rmse
from estimator.offline.result.handover import tempered
from estimator.offline.search.acceptance import NOT_WHITE, laterally_structured
from estimator.offline.search.evidence import Evidence
from hil_gateway.bus.messages import ActiveEffect, ModelRevision, Provenance
from hil_gateway.process.arrays import Array

ALTERNATIVES = 4


def as_json(diagnosis: Diagnosis, revision: str, report: str) -> dict[str, Any]:
    """The result in the agreed format."""
    std = np.sqrt(np.diag(diagnosis.spread))
    return {
        "verdict": diagnosis.verdict,
        "cut_short": diagnosis.cut_short,
        "rows": int(diagnosis.record.measured.shape[1]),
        "split": _split(diagnosis),
        "channels": {c: _rounded(v) for c, v in diagnosis.channels.items()},
        "rollout": {"horizon_s": HORIZON_S, **{n: _rounded(v) for n, v in diagnosis.rollout.items()}},
        "long_rollout": {"horizon_s": LONG_HORIZON_S, **{n: _rounded(v) for n, v in diagnosis.long_rollout.items()}},
        "lap_time_s": _rounded(diagnosis.lap_times),
        "effects": _named_effects(diagnosis),
        "not_told": [_effect(diagnosis, name) for name in diagnosis.insignificant],
        "vehicle": _vehicle(diagnosis, std),
        "unexplained": unexplained(diagnosis),
        "tyre": tyre(diagnosis, std),
        "revision": revision,
        "report": report,
    }


def _named_effects(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    shares = _shares(diagnosis)
    return [
        {
            **_effect(diagnosis, name),
            "confidence": _confidence_in(diagnosis, name),
            "share_of_residual": shares[name],
            "alternatives": _alternatives(diagnosis, name),
            "not_told_from": id_of(other) if (other := diagnosis.search.look_alikes.get(name)) else "",
        }
        for name in diagnosis.named
        if name not in DECLARED
    ]


def _effect(diagnosis: Diagnosis, name: str) -> dict[str, Any]:
    block = next(b for b in diagnosis.fit.predictor.blocks if b.effect.name == name)
    return {
        "name": id_of(name),
        "form": name,
        "parameters": sizes_of(diagnosis, block, diagnosis.spread),
        "channels": list(block.effect.channels),
    }


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(f"{value:.5g}") for name, value in values.items()}


def tyre(diagnosis: Diagnosis, std: Array) -> dict[str, dict[str, float | str]]:
    """Tyre parameters of the final model with their standard deviation."""
    table = diagnosis.fit.predictor.model.tyre_table
    return {
        p.name: {"value": float(v), "std": float(s), "unit": p.unit}
        for p, v, s in zip(table, diagnosis.fit.parameters, std, strict=False)
    }


def _split(diagnosis: Diagnosis) -> dict[str, Any]:
    """Time spans of the laps; every part of the training laps is also held out once, for the evidence."""
    t, record = diagnosis.record.signals["t"], diagnosis.record

    def spans(laps: tuple[int, ...]) -> list[list[float]]:
        rows = [record.rows[record.lap == lap] for lap in laps]
        return [[round(float(t[r.min()]), 3), round(float(t[r.max()]), 3)] for r in rows]

    train = spans(diagnosis.train_laps)
    return {
        "train": train, "validation": train, "test": spans(diagnosis.test_laps),
        "note": "every 30 s of the training laps is predicted once by a fit to the rest; no fit sees the test laps",
    }  # fmt: skip


def sizes_of(diagnosis: Diagnosis, block: Block, spread: Array) -> dict[str, dict[str, float | str]]:
    """Parameters of an effect, or the extent of its profile; `spread` (p, p) of all parameters of the fit."""
    values, own = diagnosis.fit.parameters[block.parameters], spread[block.parameters, block.parameters]
    if not block.effect.profile:
        deviations = np.sqrt(np.diag(own))
        return {
            p.name: {"value": float(v), "std": float(s), "unit": p.unit, "determined": _determined(p, float(s))}
            for p, v, s in zip(block.effect.parameters, values, deviations, strict=True)
        }
    return _profile_parameters(diagnosis, block, own)


def _determined(parameter: Parameter, std: float) -> bool:
    """Whether the data tell more about a parameter than was believed beforehand.

    Independent knowledge adds up as inverse variances: where the data tell as much as the prior, half its variance is
    left.

    Args:
        parameter: with the prior; std: what is left, in the parameter's unit.
    """
    return std**2 < 0.5 * parameter.prior_std**2


def _profile_parameters(diagnosis: Diagnosis, block: Block, spread: Array) -> dict[str, dict[str, float | str]]:
    """Size of a profile: half its range over the lap, its RMS, its extremes; `spread` (k, k) of its coefficients."""
    basis = diagnosis.record.bases[block.effect.profile]
    matrix = basis.matrix(np.linspace(0.0, basis.period, 500))
    value = matrix @ diagnosis.fit.parameters[block.parameters]
    most, least, rms = int(np.argmax(value)), int(np.argmin(value)), float(np.sqrt(np.mean(value**2)))
    by_coefficients = {
        "amplitude": (0.5 * float(np.ptp(value)), 0.5 * (matrix[most] - matrix[least])),
        "rms": (rms, value @ matrix / (len(value) * max(rms, np.finfo(float).tiny))),
        "largest": (float(value[most]), matrix[most]),
        "smallest": (float(value[least]), matrix[least]),
    }
    unit = block.effect.parameters[0].unit
    return {
        name: {"value": size, "std": float(np.sqrt(by @ spread @ by)), "unit": unit, "determined": True}
        for name, (size, by) in by_coefficients.items()
    }


def _confidence_in(diagnosis: Diagnosis, name: str) -> float:
    """By the evidence of the fits; of a road that only its own sensor shows, by that sensor's laps."""
    if not np.any(diagnosis.gains[name].laps) and name in diagnosis.fit.predictor.record.road:
        return round(diagnosis.fit.predictor.record.road[name].confidence, 4)
    return _confidence(diagnosis.gains[name])


def _confidence(evidence: Evidence) -> float:
    """Probability, by the scatter of the gain over stretches, that stretches not seen gain too (Student t)."""
    from scipy.special import stdtr

    laps = evidence.laps
    if len(laps) < 2:
        return 0.5
    spread = float(laps.std(ddof=1)) / np.sqrt(len(laps))
    probability = float(stdtr(len(laps) - 1, float(laps.mean()) / max(spread, 1e-9)))
    return round(min(0.999, probability), 4)


def _alternatives(diagnosis: Diagnosis, name: str) -> list[dict[str, float | str]]:
    """Other candidates for the same residual: probability that one gains more than `name` did, over stretches."""
    own = next(t for trials in diagnosis.search.rounds for t in trials if t.name == name)
    for trials in diagnosis.search.rounds:
        own = next((t for t in trials if t.name == name), own)
        if own.fit is not None and own in trials:
            break
    out: list[dict[str, float | str]] = []
    for trial in alternatives(diagnosis.search, name)[:ALTERNATIVES]:
        if trial.evidence.gain > 0:
            difference = Evidence(0.0, own.evidence.channels, own.evidence.laps - trial.evidence.laps)
            out.append({"name": id_of(trial.name), "confidence": round(1.0 - _confidence(difference), 4)})
    return out


def _shares(diagnosis: Diagnosis) -> dict[str, float]:
    """Share of each effect in what all accepted effects and terms gain, each given the others."""
    gains = {n: max(diagnosis.gains[n].gain, 0.0) for n in diagnosis.accepted}
    gains |= {t.effect.name: max(t.evidence.gain, 0.0) for t in diagnosis.terms}
    whole = sum(gains.values()) or 1.0
    return {n: round(g / whole, 4) for n, g in gains.items()}


def _vehicle(diagnosis: Diagnosis, std: Array) -> list[dict[str, Any]]:
    """Declared vehicle data that were found wrong, where nothing else of the lateral motion is left to explain.

    A larger inertia, say, shrinks whatever error the predicted moment has: beside other structure it is no finding.
    """
    if laterally_structured(diagnosis.fit, NOT_WHITE):
        return []
    blocks = {b.effect.name: b for b in diagnosis.fit.predictor.blocks}
    car, out = diagnosis.record.vehicle, []
    for name in (n for n in diagnosis.named if n in DECLARED):
        datum, rows = DECLARED[name], blocks[name].parameters
        value, error = float(diagnosis.fit.parameters[rows][0]), float(std[rows][0])
        found = datum.found(car, value)
        out.append({
            "name": datum.name, "declared": getattr(car, datum.name), "found": found,
            "std": abs(datum.found(car, value + error) - found), "unit": datum.unit,
        })  # fmt: skip
    return out


def as_revision(diagnosis: Diagnosis, layout: str, sessions: tuple[str, ...]) -> ModelRevision:
    """The model with its accepted catalogue effects, for estimator and planner; empirical terms stay out of it."""
    chosen = diagnosis.models["catalogue"]
    tempered_fit = tempered(chosen.model, chosen.parameters, diagnosis.fit.predictor.record, diagnosis.fit.deviation)
    size = len(chosen.model.tyre_table)
    tyre_values = {p.name: float(v) for p, v in zip(chosen.model.tyre_table, tempered_fit.parameters, strict=False)}
    effects = tuple(
        ActiveEffect(
            name=b.effect.name,
            parameters={} if b.effect.profile else _named(b, tempered_fit.parameters),
            profile=tuple(float(v) for v in tempered_fit.parameters[b.parameters]) if b.effect.profile else (),
        )
        for b in tempered_fit.predictor.blocks
        if b.effect.name in diagnosis.accepted and b.effect.name not in DECLARED
    )
    covariance = tempered_fit.covariance[:size, :size]
    after = rmse(diagnosis.record, diagnosis.test_rows, chosen.model, tempered_fit.parameters)
    return ModelRevision(
        stamp_ns=0, seq=0, revision=revision_id(layout, tyre_values, effects), layout=layout, tyre=tyre_values,
        covariance=tuple(tuple(float(v) for v in row) for row in covariance), effects=effects,
        provenance=Provenance(
            sessions=sessions,
            error_before={c: diagnosis.channels[c]["refit"] for c in CHANNELS},
            error_after={c: after[c] for c in CHANNELS},
            note=f"verdict {diagnosis.verdict}; scored on laps {', '.join(map(str, diagnosis.test_laps))}",
        ),
    )  # fmt: skip


def _named(block: Block, parameters: Array) -> dict[str, float]:
    return {p.name: float(v) for p, v in zip(block.effect.parameters, parameters[block.parameters], strict=True)}


def write(diagnosis: dict[str, Any], revision: ModelRevision, folder: Path) -> None:
    """Write diagnosis.json and model.json."""
    import json

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "diagnosis.json").write_text(json.dumps(diagnosis, indent=1))
    (folder / "model.json").write_text(revision.model_dump_json(indent=1))
