"""How often the 95 % intervals of `hil identify` contain the truth, over simulated logs with random tyres.

Run: python -m benchmarks.diagnosis.identify_coverage [LOGS]. Prints one JSON object; takes about 2 s of CPU a log.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from support.drives.drive_simulator import TYRE, Drive, random_tyres, simulate

from estimator.drive_log.table import DriveLog, segment_numbers
from estimator.model.columns import ModelColumns
from estimator.model.single_track import SingleTrack
from estimator.offline.fit.equation_error import fit
from estimator.offline.fit.output_error import OutputErrorSettings, fit_output_error
from estimator.offline.fit.recursive import averaged
from estimator.offline.predict.nuisance import steer_timing
from estimator.offline.record.declared import default_tyre_prior
from estimator.offline.record.prepare import prepare
from hil_gateway.car.car import load_car

SECONDS = 60.0
SETTINGS = OutputErrorSettings(outputs=("vy", "yaw_rate", "ay"))


def deviations(columns: ModelColumns, drive: Drive) -> list[float]:
    """(estimate - truth) / std of every tyre parameter of one log."""
    log = DriveLog(columns=drive.columns, segment=segment_numbers(drive.columns["t"]))
    samples = prepare(log)
    start = fit(columns, averaged(samples)).theta
    result = fit_output_error(columns, log, samples, SETTINGS, [columns.start, start])
    return [(result.values[n] - drive.tyre[n]) / result.std[n] for n in TYRE]


def main() -> None:
    """Print the coverage overall and per parameter."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    vehicle = load_car().vehicle
    prior = default_tyre_prior("per_axle", vehicle, load_car())
    columns = ModelColumns(SingleTrack(vehicle, prior, (steer_timing(0.01),)))
    drives = simulate(random_tyres(count, seed=101), SECONDS, seed=102)
    rows = []
    for number, drive in enumerate(drives, start=1):
        rows.append(deviations(columns, drive))
        inside = np.abs(np.array(rows)) < 1.96
        print(f"{number}/{count} coverage {inside.mean():.3f}", file=sys.stderr, flush=True)
    shares = dict(zip(TYRE, inside.mean(axis=0).round(3).tolist(), strict=True))
    print(json.dumps({"logs": count, "coverage_95": round(float(inside.mean()), 3), "per_parameter": shares}))


if __name__ == "__main__":
    main()
