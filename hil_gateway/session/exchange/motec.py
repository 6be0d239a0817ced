"""Session -> drive log as a MoTeC CSV file, which i2 imports: names, units and order of its own export."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from can_dbc.units import UNITS
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.session.drive_table import as_rows, read_drive_table
from hil_gateway.session.exchange.export import Exported
from hil_gateway.session.files.output import output_file

KMH, DEGREE, RPM = (1.0 / UNITS[unit].factor for unit in ("km/h", "deg", "rpm"))
CHANNELS: Mapping[str, tuple[str, str, float]] = {
    "t": ("Time", "s", 1.0),
    "vx": ("Ground Speed", "km/h", KMH),
    "vy": ("Lateral Velocity", "km/h", KMH),
    "yaw_rate": ("Yaw Rate", "deg/s", DEGREE),
    "ax": ("G Force Long", "G", 1.0 / GRAVITY),
    "ay": ("G Force Lat", "G", 1.0 / GRAVITY),
    "az": ("G Force Vert", "G", 1.0 / GRAVITY),
    "steer": ("Steered Angle", "deg", DEGREE),
    "drive": ("Drive Command", "", 1.0),
    "throttle": ("Throttle Pos", "%", 100.0),
    "brake": ("Brake Pressure", "kPa", 1e-3),
    "gear": ("Gear", "", 1.0),
    "engine_speed": ("Engine RPM", "rpm", RPM),
    "x": ("Pos X", "m", 1.0),
    "y": ("Pos Y", "m", 1.0),
    "yaw": ("Yaw Angle", "deg", DEGREE),
    "lap": ("Lap Number", "", 1.0),
    **{f"wheel_speed_{w}": (f"Wheel Speed {w.upper()}", "km/h", KMH) for w in ("fl", "fr", "rl", "rr")},
}
"""column -> channel of i2, its unit, and its numbers over SI; a further column keeps its name"""


def export_motec(source: Path, target: Path) -> Exported:
    """Drive log as i2 reads it."""
    table = read_drive_table(source)
    channels = {name: CHANNELS.get(name, (name, "", 1.0)) for name in table.columns}
    columns = {name: factor * table.columns[name] for name, (_, _, factor) in channels.items()}
    t = table.columns["t"]
    rate = 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    with output_file(target, source) as path, path.open("w", newline="") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_ALL)
        writer.writerows([
            ["Format", "MoTeC CSV File", "", "", "Workbook", ""],
            ["Device", "hil-gateway", "", "", "Session", source.stem],
            ["Sample Rate", f"{rate:.3f}", "Hz", "", "End Time", f"{t[-1]:.3f}", "s"],
            ["Range", "entire outing", "", "", "Duration", f"{t[-1] - t[0]:.3f}", "s"],
        ])  # fmt: skip
        file.write("\r\n\r\n")
        writer.writerows([[name for name, _, _ in channels.values()], [unit for _, unit, _ in channels.values()]])
        file.write("\r\n\r\n")
        writer.writerows([f"{value:.9g}" for value in row] for row in as_rows(columns))
    return Exported(len(t), table.left_out, table.damage)
