"""The diagnosis campaign: what it counts, and that nothing is driven twice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from benchmarks.campaign.diagnose import NONE, Case, run_cases, summarise, write_report
from benchmarks.commands.campaign import app
from hil_gateway.plant.physics.effects import SWITCHES, configure
from hil_gateway.process.errors import InputError


def _result(effect: str, named: list[str], verdict: str, seed: int = 1) -> dict[str, Any]:
    case = Case(effect, seed)
    return {"effect": effect, "seed": seed, "size": case.size, "truth": list(case.truth), "named": named,
            "verdict": verdict}  # fmt: skip


RESULTS = [
    _result(NONE, [], "none"), _result(NONE, ["wind"], "effect", 2),
    _result("aero_drag", ["aero_drag"], "effect"), _result("aero_drag", ["rolling_resistance"], "effect", 2),
    _result("wind", ["wind", "aero_drag"], "effect"), _result("front_brake", [], "unexplained"),
]  # fmt: skip


def test_shares_and_confusion_are_counted_over_the_right_cases() -> None:
    summary = summarise(RESULTS)
    assert summary["named_first"] == pytest.approx(2 / 4)
    assert summary["nothing_but_the_truth"] == pytest.approx(2 / 4), "wind brings the drag of the air it moves"
    assert summary["false_alarms"] == pytest.approx(1 / 2)
    assert summary["confusion"]["aero_drag"] == {"aero_drag": 1, "rolling_resistance": 1}
    assert summary["confusion"]["front_brake"] == {"unexplained": 1}


@pytest.mark.parametrize("effect", sorted(SWITCHES))
def test_every_drawn_size_is_one_the_car_accepts(effect: str) -> None:
    sizes = {Case(effect, seed).size for seed in range(10)}
    assert len(sizes) > 3, "seeds differ"
    for size in sizes:
        configure("paper", {effect: size})


def test_a_case_in_the_folder_is_not_driven_again(tmp_path: Path) -> None:
    (tmp_path / "wind-001-8.json").write_text(json.dumps(RESULTS[4]))
    assert list(run_cases([Case("wind", 1)], 8, tmp_path, 1)) == [RESULTS[4]]


def test_the_report_shows_the_matrix(tmp_path: Path) -> None:
    page = write_report(RESULTS, summarise(RESULTS), tmp_path / "report.html").read_text()
    assert "Confusion matrix" in page
    assert "unexplained" in page


def test_an_unknown_effect_is_named_before_anything_is_driven(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["diagnose", "--effects", "teleport", "--out", str(tmp_path / "c")])
    assert isinstance(result.exception, InputError)
    assert "teleport" in str(result.exception)
    assert not (tmp_path / "c").exists()
