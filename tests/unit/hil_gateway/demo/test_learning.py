"""Drive, diagnose, drive again: when a diagnosed model is adopted, and when it is not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil_gateway.bus.messages import ModelRevision
from hil_gateway.bus.topics import MODEL_REVISION
from hil_gateway.demo import learn
from hil_gateway.demo.learn import describe_learning, drive_learn_drive, why_not
from hil_gateway.demo.options import DemoOptions
from hil_gateway.process.own_command import CommandResult, ask
from hil_gateway.session.files.writer import SessionWriter

BETTER = {
    "horizon_s": 1.0,
    "vx": {"declared": 1.0, "refit": 0.9, "with_effects": 0.4},
    "vy": {"declared": 0.3, "refit": 0.25, "with_effects": 0.2},
    "yaw_rate": {"declared": 0.02, "refit": 0.02, "with_effects": 0.021},
}


def with_effects(**values: float) -> dict[str, Any]:
    """The rollout above with other results."""
    return {**BETTER, **{n: {"declared": 1.0, "refit": 1.0, "with_effects": v} for n, v in values.items()}}


@pytest.mark.parametrize(
    ("rollout", "words"),
    [
        (BETTER, ""),
        (with_effects(yaw_rate=1.6), "prediction of yaw_rate gets 1.60 times worse"),
        (with_effects(vx=1.0, vy=1.0, yaw_rate=1.05), "does not get better"),
    ],
)
def test_a_model_is_driven_only_when_it_predicts_held_out_data_better(rollout: dict[str, Any], words: str) -> None:
    assert words in why_not(rollout)
    assert bool(why_not(rollout)) == bool(words)


class Bench:
    """Two drives and a diagnosis that went as the test says."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.second: dict[str, Any] = {}
        self.error = {"before": 1.0, "after": 0.4}
        self.diagnosis = CommandResult(
            {"verdict": "effect", "effects": [{"name": "aero_drag"}], "rollout": BETTER, "report": "r"}
        )
        self.driven: list[DemoOptions] = []
        monkeypatch.setattr(learn, "drive", self.drive)
        monkeypatch.setattr(learn, "ask", lambda arguments, timeout_s: self.diagnosis)
        monkeypatch.setattr(learn, "measure", lambda session, models: self.error)

    def drive(self, options: DemoOptions) -> dict[str, Any]:
        session = (options.out or self.folder) / "session.mcap"
        session.parent.mkdir(parents=True, exist_ok=True)
        revision = ModelRevision(stamp_ns=0, seq=0, revision="declared", layout="shared", tyre={"b": 9.0})
        writer = SessionWriter(session, {}, 10**9)
        writer.add(MODEL_REVISION.key, revision.model_dump_json().encode(), 0, 0, 0)
        writer.close(0)
        self.driven.append(options)
        summary = {"ok": True, "ending": "done", "lap_times_s": [100.0], "session": str(session), "model_error": {}}
        return summary if len(self.driven) == 1 else {**summary, **self.second}


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(tmp_path, monkeypatch)


def test_the_better_model_is_driven_and_both_drives_are_reported(bench: Bench) -> None:
    summary = drive_learn_drive(DemoOptions(laps=2, effects=("aero_drag=1",)))
    assert summary["ok"]
    assert summary["learning"]["adopted"]
    assert summary["model_error"] == {"before": 1.0, "after": 0.4}
    assert len(summary["drives"]) == 2
    assert bench.driven[1].model.endswith("diagnosis/model.json")
    assert bench.driven[1].effects == bench.driven[0].effects
    assert json.loads((bench.folder / "declared.json").read_text())["revision"] == "declared"
    assert any("aero_drag" in line for line in describe_learning(summary))


def test_what_is_left_unexplained_and_what_is_adopted_are_both_said() -> None:
    diagnosis = {"verdict": "unexplained", "effects": [], "report": "report.html"}
    summary = {"learning": {"adopted": True, "reason": "", "diagnosis": diagnosis}}
    found, model = describe_learning(summary)
    assert "no effect of the catalogue found; more than noise is left" in found
    assert model.endswith("adopted: tyres identified anew")
    diagnosis["effects"] = [{"name": "aero_drag"}]
    found, model = describe_learning(summary)
    assert "aero_drag found; more than noise is left" in found
    assert model.endswith("adopted: aero_drag, tyres identified anew")


@pytest.mark.parametrize(
    ("second", "error", "words"),
    [
        ({"ok": False}, {"before": 1.0, "after": 0.4}, "second drive"),
        ({"lap_times_s": [103.0]}, {"before": 1.0, "after": 0.4}, "slower"),
        ({}, {"before": 1.0, "after": 1.1}, "worse than with the declared model"),
        ({}, {"before": None, "after": None}, "worse than with the declared model"),
    ],
)
def test_a_regress_drops_the_model_again(
    bench: Bench, second: dict[str, Any], error: dict[str, Any], words: str
) -> None:
    bench.second, bench.error = second, error
    summary = drive_learn_drive(DemoOptions())
    assert not summary["learning"]["adopted"]
    assert not summary["ok"]
    assert words in summary["learning"]["reason"]


def test_a_model_that_is_not_better_is_never_driven(bench: Bench) -> None:
    bench.diagnosis = CommandResult({**bench.diagnosis.content, "rollout": with_effects(vy=5.0)})
    summary = drive_learn_drive(DemoOptions())
    assert len(bench.driven) == 1
    assert not summary["learning"]["adopted"]


def test_a_diagnosis_that_fails_is_said_with_its_reason(bench: Bench) -> None:
    bench.diagnosis = CommandResult({}, "too short a session")
    summary = drive_learn_drive(DemoOptions())
    assert not summary["ok"]
    assert summary["learning"]["reason"] == "too short a session"


def test_a_command_that_fails_becomes_a_reason_without_a_traceback(tmp_path: Path) -> None:
    answer = ask(["session", "info", str(tmp_path / "absent.mcap")], 60.0)
    assert answer.content == {}
    assert "absent.mcap: cannot read" in answer.reason
