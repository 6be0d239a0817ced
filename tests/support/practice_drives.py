"""Practice drives of `benchmarks/practice`, whose equations are not the estimator's."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.offline.record.record import Record, make_record
from hil_gateway.car.vehicle import Vehicle

PRIOR = {"cx": 50000.0, "bf": 9.0, "cf": 1.35, "df": 1.3567, "br": 10.0, "cr": 1.4, "dr": 1.3392}


def practice() -> Any:
    """The package."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "practice" / "__init__.py"
    spec = importlib.util.spec_from_file_location("practice", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["practice"] = module
    spec.loader.exec_module(module)
    return module


def record_of(drive: Any) -> Record:
    """A drive ready to be diagnosed."""
    log = DriveLog(drive.columns, np.zeros(len(drive.columns["t"]), np.int64))
    return make_record(log, Vehicle())
