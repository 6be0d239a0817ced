"""Practice drives of `benchmarks/practice`, whose equations are not the estimator's."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.once import kept, once

from estimator.drive_log.table import DriveLog
from estimator.offline.record.record import Record, make_record
from hil_gateway.car.car import load_car

PRIOR = {"cx": 50000.0, "bf": 9.0, "cf": 1.35, "df": 1.3567, "br": 10.0, "cr": 1.4, "dr": 1.3392}


def practice() -> Any:
    """The package."""
    path = Path(__file__).resolve().parents[3] / "benchmarks" / "practice" / "__init__.py"
    spec = importlib.util.spec_from_file_location("practice", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["practice"] = module
    spec.loader.exec_module(module)
    return module


EFFECTS: dict[str, tuple[int, dict[str, float]]] = {
    "none": (21, {}),
    "single": (22, {"rolling_resistance": 420.0}),
    "pair": (23, {"aero_drag": 0.6, "steer_offset": -0.005}),
    "outside": (24, {"gust": 1200.0}),
    "flat": (41, {}),
    "hilly": (42, {"road_bank": 0.06, "road_grade": 0.04}),
    "nothing": (51, {}),
    "much": (52, {"aero_downforce": 1.5, "combined_slip": 1.0, "yaw_damping": 2000.0}),
    "play": (61, {"steer_play": 0.006}),
    "lag": (67, {"steer_delay/lag": 0.08}),
    "swing": (65, {"steer_resonance": 0.2}),
    "heat": (66, {"tyre_heat": 0.2}),
    "gyro": (68, {"gyro_gain": 0.04}),
    "stiffer": (69, {"stiffness_rise": 0.2}),
    "dragging": (70, {"sticky_brake": 700.0}),
    "bent": (71, {"torque_curve": 0.25}),
    "drift": (72, {"grip_drift": -2e-4, "rolling_resistance": 390.0}),
    "pulses": (62, {"pulses": 600.0}),
    "patch": (64, {"aero_drag": 0.6, "grip_patch": 0.3}),
    "car": (63, {"aero_drag": 0.6, "aero_downforce": 1.2, "load_transfer": 0.3, "combined_slip": 1.0}),
}
"""name -> seed and effects of the drives that tests share"""
LAPS = 4
SHARED = "practice_drives"


def shared_drives(factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The drives of `EFFECTS`, of four laps, side by side: all take as long as one."""
    made, module = once(factory, SHARED, _simulated), practice()
    return {name: module.Drive(*drive) for name, drive in zip(EFFECTS, made, strict=True)}


def _simulated() -> list[Any]:
    seeds, effects = zip(*EFFECTS.values(), strict=True)
    return [(d.columns, d.effects, d.seed) for d in practice().simulate(effects, seeds, laps=LAPS, step=0.01)]


def record_of(drive: Any) -> Record:
    """A drive ready to be diagnosed."""
    log = DriveLog(drive.columns, np.zeros(len(drive.columns["t"]), np.int64))
    return make_record(log, load_car().vehicle)


if __name__ == "__main__":  # made beside what else uses one processor, before the tests ask
    kept(Path(sys.argv[1]), SHARED, _simulated)
