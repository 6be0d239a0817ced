"""A recorded session as arrays: python docs/examples/read_session.py SESSION.mcap

`pandas.DataFrame(table.columns)` is the same as a data frame.
"""

import sys
from pathlib import Path

import numpy as np

from hil_gateway.session.drive_table import read_drive_table

table = read_drive_table(Path(sys.argv[1]))
drive = table.columns  # name -> array, SI (docs/formats.md)
for name in ("vx", "ay", "steer", "throttle", "brake"):
    low, middle, high = np.quantile(drive[name], (0.0, 0.5, 1.0))
    print(f"{name:8} {low:10.3f} to {high:10.3f}, median {middle:10.3f}")
for lap in np.unique(drive.get("lap", [])):
    speeds = drive["vx"][drive["lap"] == lap]
    print(f"lap {lap:g}: {speeds.min():.1f} to {speeds.max():.1f} m/s, mean {speeds.mean():.1f}")
for reason, rows in table.left_out.items():
    print(f"{rows} rows left out: {reason}")
