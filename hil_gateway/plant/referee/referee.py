"""The referee: laps, lap times and excursions from the plant's own state. Nothing that drives may listen."""

from __future__ import annotations

from hil_gateway.bus.messages import Truth
from hil_gateway.plant.car import Car
from hil_gateway.plant.referee.judge import LoadJudge
from hil_gateway.track.lap_clock import LapClock

HALF_WIDTH_M = 0.95
"""of the car over its wheels; off track is when a wheel leaves road and pit lane"""


class Referee:
    """Counts; `step` at any rate."""

    def __init__(self, car: Car) -> None:
        self._car = car
        self.loads = LoadJudge(car)
        self._s = car.road.s
        self._clock = LapClock(car.road.track.length)
        self.off_track = False
        self.off_track_count = 0
        self.distance_m = 0.0
        self.peak_speed = 0.0
        self.worst_margin_m = float("inf")
        self._seq = 0

    @property
    def laps(self) -> int:
        """Laps completed, from line to line."""
        return len(self._clock.laps)

    @property
    def lap_times_s(self) -> list[float]:
        """Of the laps completed, s."""
        return [lap.time_s for lap in self._clock.laps]

    def step(self, time_s: float) -> None:
        """Take in where the car is at `time_s`."""
        road, track = self._car.road, self._car.road.track
        moved = (road.s - self._s + 0.5 * track.length) % track.length - 0.5 * track.length
        self._s = road.s
        self.distance_m += abs(moved)
        self.peak_speed = max(self.peak_speed, self._car["vx"])
        self._clock.update(time_s, road.s, self._car["vx"])
        self._judge()

    def _judge(self) -> None:
        road = self._car.road
        margin = road.track.inside(road.s, road.lateral) - HALF_WIDTH_M
        self.worst_margin_m = min(self.worst_margin_m, margin)
        off = margin < 0.0
        self.off_track_count += off and not self.off_track
        self.off_track = off

    def truth(self, now_ns: int) -> Truth:
        """The message for whoever watches."""
        car, road = self._car, self._car.road
        self._seq += 1
        return Truth(
            stamp_ns=now_ns,
            seq=self._seq,
            x=car["x"],
            y=car["y"],
            z=float(road.track.at(road.s).z),
            yaw=car["yaw"],
            vx=car["vx"],
            vy=car["vy"],
            yaw_rate=car["yaw_rate"],
            s=road.s,
            lateral_offset=road.lateral,
            off_track=self.off_track,
            lap=self.laps,
            lap_times_s=tuple(self.lap_times_s),
            off_track_count=self.off_track_count,
            friction_used=self.loads.friction,
            friction_over_s=round(self.loads.longest_over_s, 3),
            slides=self.loads.slides,
            spins=self.loads.spins,
        )
