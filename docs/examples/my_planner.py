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
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import Command, Estimate
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config, load_config
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

SPEED, WALKING, AHEAD, PERIOD_S = 10.0, 1.5, 12.0, 0.05  # m/s, m/s, m, s
GAIN, HARDEST = 0.02, 0.05  # drive command per m/s, and at most: slip ratio, declared C_x times it is the force


class MyPlanner:
    """Estimate in, command out; `planner/simulation/loop.py` drives it on a virtual clock, too."""

    def __init__(self, config: Config, bus: Bus, track: Track) -> None:
        self.config, self.bus, self.track, self.seq = config, bus, track, 0
        self.estimates: LatestReader[Estimate] = LatestReader(bus, topics.ESTIMATE)

    def step(self, now_ns: int) -> None:
        newest = self.estimates.update(now_ns)
        e = newest.message
        if e is None or not newest.alive(now_ns) or not (e.valid or e.lacks == "heading"):
            return
        # where a car points that has not moved yet, its first metres show: straight on, at walking pace
        steer, speed = (self.steer(e), SPEED) if e.valid else (0.0, WALKING)
        drive = max(-HARDEST, min(HARDEST, GAIN * (speed - e.vx)))
        command = Command(
            stamp_ns=now_ns, seq=self.seq, source="my_planner", state_stamp_ns=e.state_stamp_ns,
            steer=steer, drive=drive,
        )  # fmt: skip
        self.bus.publish(topics.COMMAND, command)
        self.seq += 1

    def steer(self, e: Estimate) -> float:
        """Pure pursuit: the road-wheel angle whose circle goes through the road's middle `AHEAD` metres on."""
        goal = self.track.at(self.track.project(e.x, e.y)[0] + AHEAD)
        across = math.sin(math.atan2(goal.y - e.y, goal.x - e.x) - e.yaw)
        return math.atan(2.0 * self.config.vehicle.wheelbase * across / AHEAD)


if __name__ == "__main__":
    config = load_config(None)
    bus = open_bus(config.zenoh, "planner")
    planner = MyPlanner(config, bus, load_track(sys.argv[2] if len(sys.argv) > 2 else config.track))
    end = time.monotonic() + (float(sys.argv[1]) if len(sys.argv) > 1 else math.inf)
    while time.monotonic() < end:
        planner.step(time.monotonic_ns())
        time.sleep(PERIOD_S)
    bus.close()
