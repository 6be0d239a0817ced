"""Identify the tyres of a log: python docs/examples/identify_my_log.py LOG [VEHICLE.json [TYRE.json]]"""

import sys
from pathlib import Path

from estimator.drive_log.table import read_logs
from estimator.offline.identification import Options, identify
from estimator.offline.record.declared import read_tyre_prior, read_vehicle
from hil_gateway.car.car import load_car

log, vehicle, tyre = (*map(Path, sys.argv[1:]), None, None)[:3]
car = read_vehicle(vehicle, load_car())
result = identify(read_logs([log]), car, read_tyre_prior(tyre, "per_axle", car, load_car()), Options())

for name, value in result.final.items():
    known = "known" if result.identifiability.identifiable[name] else "not determined by this log"
    print(f"{name:4} {result.initial[name]:10.4g} -> {value:10.4g} +- {result.fit.std[name]:.2g}  {known}")
for channel, rmse in result.summary()["rmse"].items():
    print(f"{channel}: error on held-out data {rmse['initial']:.3g} before, {rmse['final']:.3g} after")
for finding in result.health.findings:
    print(f"log health: {finding.description}")
