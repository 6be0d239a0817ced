"""A recorded session as a pandas table: python docs/examples/read_session.py SESSION.mcap"""

import sys
from pathlib import Path

import pandas as pd

from hil_gateway.session.drive_table import read_drive_table

table = read_drive_table(Path(sys.argv[1]))
drive = pd.DataFrame(table.columns).set_index("t")
print(drive[["vx", "ay", "steer", "throttle", "brake"]].describe().round(3))
if "lap" in drive:
    print(drive.groupby("lap")["vx"].agg(["min", "mean", "max"]).round(1))
for reason, rows in table.left_out.items():
    print(f"{rows} rows left out: {reason}")
