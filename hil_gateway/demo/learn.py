"""The closed loop with a person's patience: drive, diagnose the recording, adopt the better model, drive again.

A model is adopted only when it predicts held-out data better, and dropped again when the second drive is worse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil_gateway.bus.topics import MODEL_REVISION
from hil_gateway.demo.drive import drive, say
from hil_gateway.demo.folder import hold
from hil_gateway.demo.model_error import measure
from hil_gateway.demo.options import DemoOptions
from hil_gateway.process.figures import figure
from hil_gateway.process.own_command import ask
from hil_gateway.session.files.format import unpack_message
from hil_gateway.session.files.reader import SessionReader

DEFAULT_LAPS = 3
"""fewer leave too little to learn from, choose by and test on"""
DIAGNOSE_S = 900.0
WORST_CHANNEL = 1.5
"""no predicted quantity may get that much worse than with the declared model, on held-out data"""
SLOWER = 1.02
"""a best lap that much longer is a regress"""


def drive_learn_drive(options: DemoOptions) -> dict[str, Any]:
    """Summary of the drive with the better model (or of the only one), with `learning` and both `drives`."""
    first = drive(options)
    if not first["ok"] or first["ending"] != "done":
        return {**first, "learning": _not_learnt("the first drive did not end as asked")}
    with hold(Path(first["session"]).parent):
        return _learn_and_drive(options, first)


def _learn_and_drive(options: DemoOptions, first: dict[str, Any]) -> dict[str, Any]:
    """Diagnose the first drive and, with a better model, drive again."""
    folder = Path(first["session"]).parent
    say("diagnosing the session")
    answer = ask(["diagnose", first["session"], "--out", str(folder / "diagnosis")], DIAGNOSE_S)
    if answer.reason:
        return {**first, "ok": False, "learning": _not_learnt(answer.reason)}
    diagnosis, model = answer.content, folder / "diagnosis" / "model.json"
    if reason := why_not(diagnosis["rollout"]):
        return {**first, "learning": {**_not_learnt(reason), "diagnosis": _found(diagnosis)}}
    say("driving again with the diagnosed model")
    second = drive(replace(options, out=folder / "after", model=str(model)))
    error = measure(Path(second["session"]), (_declared(first, folder), model))
    learning = {**_judge(first, second, error), "diagnosis": _found(diagnosis), "model": str(model)}
    ok = second["ok"] and learning["adopted"]
    return {**second, "model_error": error, "ok": ok, "learning": learning, "drives": [first, second]}


def why_not(rollout: Mapping[str, Any]) -> str:
    """Why the diagnosed model is not better than the declared one on held-out data; empty when it is."""
    ratios = {name: row["with_effects"] / row["declared"] for name, row in rollout.items() if isinstance(row, dict)}
    worst = max(ratios, key=lambda name: ratios[name])
    if ratios[worst] > WORST_CHANNEL:
        return f"held-out prediction of {worst} gets {ratios[worst]:.2f} times worse"
    if math.prod(ratios.values()) >= 1.0:
        return "held-out prediction does not get better"
    return ""


def _declared(first: Mapping[str, Any], folder: Path) -> Path:
    """The revision the first drive began with, as a file."""
    items = SessionReader(Path(first["session"]), frozenset({MODEL_REVISION.key})).items()
    revision = unpack_message(MODEL_REVISION, next(items).data)
    path = folder / "declared.json"
    path.write_text(revision.model_dump_json(indent=1))
    return path


def _judge(first: Mapping[str, Any], second: Mapping[str, Any], error: Mapping[str, Any]) -> dict[str, Any]:
    """Whether the model stays, with the figures before and after."""
    best = [min(drive["lap_times_s"], default=None) for drive in (first, second)]
    reason = ""
    if not second["ok"]:
        reason = "the second drive did not end as asked"
    elif error["before"] is None or error["after"] > error["before"]:
        reason = "prediction in the second drive is worse than with the declared model"
    elif best[0] and best[1] and best[1] > SLOWER * best[0]:
        reason = f"the best lap is slower: {best[0]:.2f} s, then {best[1]:.2f} s"
    return {
        "adopted": not reason,
        "reason": reason,
        "prediction_error": {"before": error["before"], "after": error["after"]},
        "lap_time_s": {"before": best[0], "after": best[1]},
        "sessions": [first["session"], second["session"]],
    }


def _not_learnt(reason: str) -> dict[str, Any]:
    return {"adopted": False, "reason": reason}


def _found(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a diagnosis a reader of the summary wants."""
    wanted = ("verdict", "effects", "unexplained", "rollout", "revision", "report")
    return {name: diagnosis.get(name) for name in wanted}


def describe_learning(summary: Mapping[str, Any]) -> list[str]:
    """What was learnt, for a person."""
    learning = summary.get("learning")
    if not learning:
        return []
    lines = []
    if found := learning.get("diagnosis"):
        lines.append(f"diagnosis        {_diagnosed(found)} ({found['report']})")
    if "lap_time_s" in learning:
        lap, error = learning["lap_time_s"], learning["prediction_error"]
        for what, pair, unit in (("lap time", lap, "s"), ("prediction", error, "m")):
            before, after = (figure(pair[when], unit) for when in ("before", "after"))
            lines.append(f"{what:16} {before}, with the diagnosed model {after}")
    return [*lines, f"model            {_adopted(learning)}"]


def _diagnosed(found: Mapping[str, Any]) -> str:
    """What was found, and whether something is left."""
    effects = ", ".join(effect["name"] for effect in found["effects"])
    if found["verdict"] == "unexplained":
        rest = "more than noise is left that no effect explains"
        return f"{effects} found; {rest}" if effects else f"no effect of the catalogue found; {rest}"
    return f"{effects} found, the rest is noise" if effects else "the declared model explains the drive"


def _adopted(learning: Mapping[str, Any]) -> str:
    """What became of the model, and of what it consists."""
    if not learning["adopted"]:
        return f"not adopted: {learning['reason']}"
    effects = [effect["name"] for effect in learning["diagnosis"]["effects"]]
    return f"adopted: {', '.join([*effects, 'tyres identified anew'])}"
