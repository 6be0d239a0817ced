"""A car of your own, checked and driven on the virtual clock: python docs/examples/my_car.py NEW_FOLDER [SECONDS]

It is the invented one with another identifier, steering that counts the other way, and brake pressure in psi.
"""

import os
import shutil
import sys
from pathlib import Path

from can_dbc.folder import SHIPPED
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from planner.simulation.loop import Loop

CHANGES = {
    "kestrel.dbc": {
        "BO_ 2566852609 DRIVE_CMD": "BO_ 291 DRIVE_CMD",
        'P_FRONT : 7|16@0+ (0.005,-10) [0|200] "bar"': 'P_FRONT : 7|16@0+ (0.1,0) [0|3000] "psi"',
    },
    "signals.toml": {
        '"STR_ANG", factor = -1': '"STR_ANG", factor = 1',
        '"STR_FB", factor = -1': '"STR_FB", factor = 1',
        '"STR_FB_A", factor = -1': '"STR_FB_A", factor = 1',
        '"STR_FB_B", factor = -1': '"STR_FB_B", factor = 1',
    },
}

folder = Path(sys.argv[1])
shutil.copytree(SHIPPED / "kestrel", folder)
for name, replaced in CHANGES.items():
    text = (folder / name).read_text(encoding="utf-8")
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    (folder / name).write_text(text, encoding="utf-8")

os.environ["HIL_PLATFORM"] = str(folder)  # as `--platform` does: everything in this process works with that car
car = load_car()  # a mistake is one line: file, key, value, what is allowed
print(f"{car.name}: {car.vehicle.mass:g} kg, {len(car.imus)} inertial sensors")
loop = Loop(Config(track="oval"))
result = loop.run(seconds=float(sys.argv[2]) if len(sys.argv) > 2 else 10.0)
print(f"drove {result.distance_m:.0f} m, fastest {result.peak_speed:.1f} m/s, off the road {result.off_track} times")
print("no stop" if not result.failsafes else f"stopped: {result.failsafes[0][2]}")
