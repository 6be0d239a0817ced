"""`hil plan bench`: one JSON object with the promised keys, exit codes, IPOPT on the same problems."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from benchmarks.plans.bench import INFORMATION_WEIGHT, bench_controller, drive, summary
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track
from planner.cli.plan import app
from planner.problem.settings import Information, declared_settings

KEYS = {
    "laps", "lap_time_s", "solve_ms", "ipopt_warm_ms", "speedup_vs_ipopt", "violations", "qp_failures",
    "information_per_s", "backend",
}  # fmt: skip


@pytest.mark.long
def test_bench_prints_one_json_object_and_keeps_all_limits() -> None:
    result = CliRunner().invoke(app, ["bench", "--track", "oval", "--no-ipopt", "--json"])
    assert result.exit_code == 0, result.output
    (line,) = result.stdout.strip().splitlines()
    report = json.loads(line)
    assert set(report) >= KEYS
    assert report["violations"] == {"track": 0, "load": 0, "actuator": 0, "information": 0}
    assert report["qp_failures"] == 0
    assert 1.0 < report["lap_ratio"][0] < 1.39  # 1.353 with the declared model's limits; 3 % slower is a regress


def test_a_drive_with_information_keeps_all_limits() -> None:
    """The first 15 s of the road course, with its tightest bend entered from the fastest straight."""
    settings = replace(
        declared_settings(load_car()), information=Information(weight=INFORMATION_WEIGHT, kind="imu_yaw")
    )
    controller, _ = bench_controller(load_track(), load_car().vehicle, settings)
    run = drive(controller, 1, steps=300)
    assert run.violations == {"track": 0, "load": 0, "actuator": 0, "information": 0}
    assert run.qp_failures == 0


def test_sqp_beats_warm_ipopt_on_the_same_problems() -> None:
    """Loose bound for busy machines; the figure is `hil plan bench`."""
    controller, _ = bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))
    report = summary(drive(controller, 1, ipopt=True, steps=81), controller)
    assert report["ipopt_warm_ms"]["samples"] >= 2
    assert report["speedup_vs_ipopt"] > 10


def test_unknown_choices_and_tracks_are_input_errors() -> None:
    assert CliRunner().invoke(app, ["bench", "--backend", "magic"]).exit_code == 2
    with pytest.raises(InputError, match="no such track"):
        CliRunner().invoke(app, ["bench", "--track", "nowhere.csv"], catch_exceptions=False)
