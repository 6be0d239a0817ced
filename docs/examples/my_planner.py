"""Drive with a planner of your own, through the gateway's arming, limits and failsafe.

    hil plant run & hil gateway run & hil estimator run &
    python docs/examples/my_planner.py [SECONDS [TRACK]] &
    hil gateway crank && hil gateway arm

It follows the middle of the road at 10 m/s. The gateway stops the car when commands stop, whoever sends them.
"""

import math
import sys
import time

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LatestReader
from hil_gateway.bus.messages import Command, Estimate
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import load_config
from hil_gateway.track.loading import load_track

SPEED, AHEAD, PERIOD_S = 10.0, 12.0, 0.05  # m/s, m, s
seconds = float(sys.argv[1]) if len(sys.argv) > 1 else math.inf
config = load_config(None)
track = load_track(sys.argv[2] if len(sys.argv) > 2 else config.track)
bus = open_bus(config.zenoh, "planner")
estimates: LatestReader[Estimate] = LatestReader(bus, topics.ESTIMATE)


def steer_towards_the_middle(e: Estimate) -> float:
    """Pure pursuit: the road-wheel angle whose circle goes through the road's middle `AHEAD` metres on."""
    place, _ = track.project(e.x, e.y)
    goal = track.at(place + AHEAD)
    across = math.sin(math.atan2(goal.y - e.y, goal.x - e.x) - e.yaw)
    return math.atan(2.0 * config.vehicle.wheelbase * across / AHEAD)


end = time.monotonic() + seconds
seq = 0
while time.monotonic() < end:
    newest = estimates.update(time.monotonic_ns())
    if newest.message is not None and newest.valid(time.monotonic_ns()):
        e = newest.message
        drive = max(-0.02, min(0.01, 0.005 * (SPEED - e.vx)))
        now = time.monotonic_ns()
        bus.publish(
            topics.COMMAND,
            Command(
                stamp_ns=now, seq=seq, source="my_planner", state_stamp_ns=e.state_stamp_ns,
                steer=steer_towards_the_middle(e), drive=drive,
            ),
        )  # fmt: skip
        seq += 1
    time.sleep(PERIOD_S)
bus.close()
