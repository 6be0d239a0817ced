"""Contraction: the plain planner's SQP steps shrink and its drives come together; `hil plan contraction` reports it."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.plans.bench import bench_controller
from benchmarks.plans.contraction import CASES, measure, step_ratios
from hil_gateway.car.car import load_car
from hil_gateway.track.loading import load_track
from planner.cli.plan import app
from planner.problem.settings import declared_settings

PLACES = 6


def test_steps_and_neighbouring_drives_of_the_plain_planner_contract() -> None:
    controller, _ = bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))
    found = measure(controller, PLACES)
    assert len(found.iterations) >= 3 * PLACES
    assert np.mean(found.iterations < 1.0) > 0.85, "SQP steps grow"
    assert np.median(found.trajectories) < 0.6, "the closed loop does not forget where it started"


def test_ratios_are_those_of_successive_steps_down_to_the_noise_of_the_solver() -> None:
    norms = iter([1.0, 0.5, 1.0, 5e-4, 5e-4, 5e-4])
    sqp = SimpleNamespace(z=np.zeros(1), du=np.zeros(1), set_guess=lambda z, du: None)
    solver: Any = SimpleNamespace(sqp=sqp, solve=lambda *_: SimpleNamespace(step_norm=next(norms)))
    assert step_ratios(solver, np.zeros(10)) == pytest.approx([0.5, 2.0, 5e-4])


@pytest.mark.long
def test_the_command_reports_every_case() -> None:
    result = CliRunner().invoke(app, ["contraction", "--track", "oval", "--places", "2", "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert set(report["cases"]) == set(CASES)
    for case in report["cases"].values():
        for ratio in case.values():
            assert ratio["median"] > 0.0 and 0.0 <= ratio["share_below_1"] <= 1.0
