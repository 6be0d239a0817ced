"""Every promise has a test, every marked test a promise, and the report says what happened."""

from __future__ import annotations

import ast
import json
from functools import cache
from pathlib import Path

import pytest

from benchmarks.commands.verify import verify
from benchmarks.promises.promises import PROMISES, Evidence, as_json, keep_long, markdown, read_evidence
from hil_gateway.process.errors import InputError

TESTS = Path(__file__).resolve().parents[2]


@cache
def marked() -> dict[str, set[str]]:
    """Promise -> tests marked with it, read from the sources."""
    found: dict[str, set[str]] = {}
    for path in TESTS.rglob("test_*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            is_mark = (
                isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "promise"
            )
            if is_mark and node.args and isinstance(node.args[0], ast.Constant):
                found.setdefault(str(node.args[0].value), set()).add(path.name)
    return found


@pytest.mark.parametrize("promise", PROMISES, ids=lambda promise: promise.id)
def test_a_promise_without_a_test_fails(promise):
    assert marked().get(promise.id), f"{promise.id} ({promise.text}) has no test"


def test_a_mark_without_a_promise_fails():
    assert set(marked()) <= {promise.id for promise in PROMISES}


def test_an_unknown_promise_is_one_clear_line():
    with pytest.raises(InputError, match="no promise S9, Z1"):
        verify(only="S1,Z1,S9")


@pytest.mark.parametrize(
    ("page", "others"),
    [
        (".", {}),
        ("page.md", {"only": "S1"}),
        ("page.md", {"long": True}),
        ("page.md", {"seeds": 1}),
    ],
)
def test_a_page_that_could_not_be_whole_is_refused_before_any_test_runs(tmp_path, page, others):
    with pytest.raises(InputError, match="--page"):
        verify(page=tmp_path / page, **others)
    assert list(tmp_path.iterdir()) == []


def test_the_page_is_written_where_it_is_asked_for_and_nowhere_else(tmp_path, capsys):
    figures = tmp_path / "figures.jsonl"
    figures.write_text(json.dumps({"promise": "S1", "test": "a.py::test_x", "outcome": "passed"}))
    committed = TESTS.parent / "docs" / "promises.md"
    before = committed.read_bytes()
    verify(gathered=figures)
    verify(gathered=figures, page=tmp_path / "page.md")
    assert committed.read_bytes() == before
    assert "| S1 |" in (tmp_path / "page.md").read_text()
    assert "S1  kept" in capsys.readouterr().out


def test_the_report_takes_the_worst_outcome_and_every_figure_once(tmp_path):
    lines = [
        {"promise": "S1", "test": "a.py::test_x[1]", "outcome": "passed"},
        {"promise": "S1", "test": "a.py::test_x[1]", "outcome": "failed"},
        {"promise": "S1", "figure": "10 | 20"},
        {"promise": "S1", "figure": "10 | 20"},
        {"promise": "S2", "test": "a.py::test_y", "outcome": "passed"},
        {"promise": "S3", "test": "a.py::test_z", "outcome": "skipped"},
    ]
    path = tmp_path / "figures.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)))
    evidence = read_evidence(path)
    assert [evidence[name].verdict for name in ("S1", "S2", "S3", "S4")] == [
        "BROKEN", "kept", "not proved here", "not proved here",
    ]  # fmt: skip
    text = markdown(evidence, "now", {"S2": {"verdict": "kept", "run": "a long run", "figures": ["all of it"]}})
    assert text.count("- **S1** 10 | 20\n") == 1
    assert "machine): 1 of a long run\n" in text
    assert "| kept | kept (1) |" in text
    assert "- **S2** all of it\n- **S3** no figure\n" in text
    assert len(as_json(evidence)) == len(PROMISES)


def test_figures_are_those_of_the_long_run_where_there_is_one():
    usual = {promise.id: Evidence() for promise in PROMISES} | {
        "S1": Evidence({}, ["10 of 9.5 m"]),
        "S2": Evidence({}, ["20 commands", "none\nlost"]),
    }
    long = {"S1": {"verdict": "kept", "run": "Monday", "figures": ["1,000 of 9.5 m", "same"]}}
    text = markdown(usual, "now", long)
    assert "- **S1** 1,000 of 9.5 m; same\n- **S2** 20 commands; none lost\n" in text


@pytest.mark.parametrize(("outcome", "whole"), [("passed", False), ("failed", True)])
def test_long_figures_are_cut_where_the_promise_is_kept(tmp_path, outcome, whole):
    path = tmp_path / "figures.jsonl"
    lines = [{"promise": "S1", "figure": f"{'figure ' * 100}end"}, {"promise": "S1", "test": "x", "outcome": outcome}]
    path.write_text("\n".join(map(json.dumps, lines)))
    assert ("figure end\n" in markdown(read_evidence(path), "now", {})) == whole


def test_what_passed_only_when_run_again_is_told(tmp_path):
    path = tmp_path / "figures.jsonl"
    outcomes = ("failed", "passed")
    path.write_text("\n".join(json.dumps({"promise": "S1", "test": "a.py::x", "outcome": o}) for o in outcomes))
    assert read_evidence(path)["S1"].verdict == "kept on the second try"


def test_a_long_run_of_some_promises_keeps_what_is_known_of_the_others(tmp_path):
    path = tmp_path / "long.json"
    keep_long(path, {"S1": Evidence({"t": "passed"}, ["a"]), "S2": Evidence({"t": "failed"}, ["b"])}, "Monday")
    keep_long(path, {"S1": Evidence(), "S2": Evidence({"t": "passed"}, ["c"])}, "Tuesday")
    kept = json.loads(path.read_text())
    assert kept["S1"] == {"verdict": "kept", "figures": ["a"], "run": "Monday"}
    assert kept["S2"] == {"verdict": "kept", "figures": ["c"], "run": "Tuesday"}
