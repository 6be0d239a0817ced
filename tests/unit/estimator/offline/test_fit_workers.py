"""Fits in processes side by side find what fits one after the other find."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from support.practice_drives import PRIOR, record_of, shared_drives

from estimator.offline.search.every_car import fitted_together, on_every_car
from estimator.offline.search.screening import open_candidates, screen
from estimator.offline.search.trial import Setting, fit_names
from estimator.offline.search.workers import Job, fit_each, workers


def test_fits_side_by_side_agree_with_fits_in_turn(tmp_path_factory: pytest.TempPathFactory) -> None:
    record = record_of(shared_drives(tmp_path_factory)["single"])
    setting = Setting(record.select(record.lap == 0), "per_axle", PRIOR)
    warm = fit_names(setting, (), None)
    jobs = [Job("resistance", ("rolling_resistance",)), Job("drag", ("aero_drag",), iterations=1)]
    said: list[str] = []
    in_turn = fit_each(setting, warm, jobs, said.append)
    with workers(2) as pool:
        beside = fit_each(Setting(setting.record, "per_axle", PRIOR, pool=pool), warm, jobs, said.append)
    assert said == ["resistance", "drag"] * 2
    for one, other in zip(in_turn, beside, strict=True):
        assert np.allclose(one.parameters, other.parameters, rtol=1e-9)
        assert np.allclose(one.held_out(), other.held_out(), rtol=1e-9)


def test_what_is_screened_with_short_fits_and_forms_of_one_effect_are_fitted_side_by_side(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    drive = shared_drives(tmp_path_factory)["single"]
    columns = drive.columns | {"brake": np.maximum(-drive.columns["drive"], 0.0), "throttle": 0.0 * drive.columns["t"]}
    record = record_of(replace(drive, columns=columns))
    setting = Setting(record.select(record.lap == 0), "per_axle", PRIOR)
    current = fit_names(setting, (), None)
    effects = [e for e in open_candidates(setting, []) if e.initial]
    with ThreadPoolExecutor(1) as pool:
        sent = Mock(wraps=pool, spec=Executor)
        screen(replace(setting, pool=sent), [], current, lambda _: None, effects)
        assert sent.submit.call_count == len(effects) > 1
        fitted_together(replace(setting, pool=sent), [], current)
        assert sent.submit.call_count == len(effects) + len(on_every_car(setting, [])) > len(effects) + 1


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
