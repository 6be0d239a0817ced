"""The safety files are tested to the last branch, and their tests notice changes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.promise_figures import FIGURES_VARIABLE, LONG_VARIABLE, ONLY_VARIABLE, record_figure, volume

from benchmarks.promises.mutation import TARGETS

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
@pytest.mark.promise("S6")
def test_limits_failsafe_and_codec_are_covered_to_the_last_branch(tmp_path):
    report = tmp_path / "coverage.json"
    tests = [test for tests in TARGETS.values() for test in tests]
    command = [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not vcan and not slow",
        *(f"--cov={module}" for module in TARGETS), "--cov-branch", f"--cov-report=json:{report}", *tests,
    ]  # fmt: skip
    environment = {**_environment(), "HIL_SHARE": "0.05", "COVERAGE_FILE": str(tmp_path / "coverage")}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    files = json.loads(report.read_text())["files"]
    assert len(files) == len(TARGETS)
    for name, file in files.items():
        assert file["summary"]["percent_covered"] == 100.0, (name, file["missing_lines"], file["missing_branches"])
    branches = sum(file["summary"]["num_branches"] for file in files.values())
    record_figure("S6", f"{branches} branches of {len(files)} files covered, 100 %")


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.promise("S6")
def test_no_mutant_survives_without_a_reason():
    script = (
        "import json, sys; from pathlib import Path; from benchmarks.promises import mutation;"
        f"print(json.dumps(mutation.run(Path({str(ROOT)!r}), {_modules()!r}, {volume(18, 1)})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=ROOT, env=_environment()
    )
    assert done.returncode == 0, done.stderr[-3000:]
    report = json.loads(done.stdout)
    assert report["unexplained"] == []
    mutants = sum(count["mutants"] for count in report["counts"].values())
    record_figure(
        "S6", f"{mutants} mutants of {', '.join(report['counts'])}: {len(report['survivors'])} survive with a reason"
    )


def _environment() -> dict[str, str]:
    """Without what a run of the promises sets: all tests at their usual volume; what fails on a mutant breaks none."""
    ours = ("PYTEST_XDIST_WORKER", FIGURES_VARIABLE, LONG_VARIABLE, ONLY_VARIABLE)
    kept = {name: value for name, value in os.environ.items() if name not in ours}
    return {**kept, "PYTHONPATH": str(ROOT / "tests")}


def _modules() -> tuple[str, ...]:
    """The codec's tests take long: its mutants are for the long run."""
    return tuple(TARGETS)[: volume(2, len(TARGETS))]
