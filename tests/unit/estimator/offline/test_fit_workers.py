"""Fits in processes side by side find what fits one after the other find."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.practice_drives import PRIOR, record_of, shared_drives

from estimator.offline.search.trial import Setting, fit_names
from estimator.offline.search.workers import Job, fit_each, workers


def test_fits_side_by_side_agree_with_fits_in_turn(tmp_path_factory: pytest.TempPathFactory) -> None:
    record = record_of(shared_drives(tmp_path_factory)["single"])
    setting = Setting(record.select(record.lap == 0), "per_axle", PRIOR)
    warm = fit_names(setting, (), None)
    jobs = [Job("resistance", ("rolling_resistance",)), Job("drag", ("aero_drag",))]
    said: list[str] = []
    in_turn = fit_each(setting, warm, jobs, said.append)
    with workers(2) as pool:
        beside = fit_each(Setting(setting.record, "per_axle", PRIOR, pool=pool), warm, jobs, said.append)
    assert said == ["resistance", "drag"] * 2
    for one, other in zip(in_turn, beside, strict=True):
        assert np.allclose(one.parameters, other.parameters, rtol=1e-9)
        assert np.allclose(one.held_out(), other.held_out(), rtol=1e-9)


THREADS_AT_IMPORT = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            print(os.environ.get("OPENBLAS_NUM_THREADS"))
sys.meta_path.insert(0, Watch())
from hil_gateway.cli.main import main
sys.argv = ["hil", "diagnose", sys.argv[1]]
main()
"""


def test_linear_algebra_of_a_diagnosis_runs_in_one_thread_beside_the_fits(tmp_path: Path) -> None:
    command = [sys.executable, "-c", THREADS_AT_IMPORT, str(tmp_path / "absent.csv")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout.split()[:1] == ["1"]
