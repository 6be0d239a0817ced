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
from support.drives.practice_drives import PRIOR, record_of, shared_drives

from estimator.offline.record.record import Record
from estimator.offline.search.every_car import fitted_together, on_every_car
from estimator.offline.search.pool import RECORDS, Pool, workers
from estimator.offline.search.screening import open_candidates, screen
from estimator.offline.search.trial import Setting, fit_names
from estimator.offline.search.workers import FitJob, fit_each


def test_fits_side_by_side_agree_with_fits_in_turn(tmp_path_factory: pytest.TempPathFactory) -> None:
    record = record_of(shared_drives(tmp_path_factory)["single"])
    setting = Setting(record.select(record.lap == 0), "per_axle", PRIOR)
    warm = fit_names(setting, (), None)
    jobs = [FitJob("resistance", ("rolling_resistance",)), FitJob("drag", ("aero_drag",), iterations=1)]
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
    with ThreadPoolExecutor(1) as executor:
        sent = Mock(wraps=executor, spec=Executor)
        beside = replace(setting, pool=Pool(sent, tmp_path_factory.mktemp("records")))
        screen(beside, [], current, lambda _: None, effects)
        assert sent.submit.call_count == len(effects) > 1
        fitted_together(beside, [], current)
        assert sent.submit.call_count == len(effects) + len(on_every_car(setting, [])) > len(effects) + 1


def number_of_windows(record: Record, other: Record) -> tuple[int, bool]:
    """What a task says of the records that it got."""
    return record.windows, record is other


def test_a_record_is_written_once_for_all_tasks_and_old_ones_are_deleted(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    record = record_of(shared_drives(tmp_path_factory)["single"])
    with ThreadPoolExecutor(1) as executor:
        pool = Pool(executor, tmp_path)
        done = [pool.submit(number_of_windows, record, record).result() for _ in range(3)]
        assert done == [(record.windows, True)] * 3
        assert len(list(tmp_path.iterdir())) == 1
        for lap in range(2 * RECORDS):
            part = record.select(record.lap == lap % 2)
            assert pool.submit(number_of_windows, part, record).result() == (part.windows, False)
        pool.forget_old()
        assert len(list(tmp_path.iterdir())) == RECORDS
        assert pool.submit(number_of_windows, record, record).result() == (record.windows, True)


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
