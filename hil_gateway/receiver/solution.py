"""What a log or sentence says, in units and axes of the project. Pure.

NovAtel: azimuth and track clockwise from north; inertial axes x to the right, y ahead, z up (SPAN), rates about them as
rad and m/s since the log before. Here: yaw from east, positive to the left; x ahead, y to the left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hil_gateway.bus.messages import Heading
from hil_gateway.bus.outside import Place, Quality, Rates, Velocity
from hil_gateway.car.car import Receiver
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.receiver.gates import judge, judge_sentence
from hil_gateway.receiver.nmea import Sentence
from hil_gateway.receiver.oem7 import ReceiverLog

Values = Mapping[str, float]
ANTENNAS = ("HEADING2", "DUALANTENNAHEADING")
"""logs whose heading is that of the line between two antennas"""
INCREMENTS = "CORRIMUS"
INTERVAL_MAX_NS = NS_PER_S
"""between two logs of increments: longer, one was lost"""


@dataclass(frozen=True, slots=True)
class Solution:
    """One log or sentence: GPS time it is of (ns), quality, and what it has of place, velocity, heading and rates."""

    log: str
    gps_ns: int
    quality: Quality
    reason: str = ""
    place: Place | None = None
    velocity: Velocity | None = None
    heading: Heading | None = None
    rates: Rates | None = None


class Solutions:
    """Logs and sentences of one receiver as solutions; increments need the time of the log before.

    Raises nothing but `ValueError`, of a number that is out of any range.
    """

    def __init__(self, declared: Receiver) -> None:
        self._turned, self._increments_ns = declared.yaw, 0

    def of_log(self, log: ReceiverLog) -> Solution | None:
        """None of a log that says nothing of the motion."""
        if log.name not in MOTION:
            return None
        quality, reason = judge(log)
        if quality is Quality.REFUSED:
            return Solution(log.name, log.gps_ns, quality, reason)
        if log.name in ANTENNAS:
            return Solution(log.name, log.gps_ns, quality, reason, heading=self._of_antennas(log.values))
        if log.name == INCREMENTS:
            return self._increments(log, quality, reason)
        place, velocity, heading = PARTS[log.name](log.values)
        late_ns = round(log.values.get("latency_s", 0.0) * NS_PER_S)
        return Solution(log.name, log.gps_ns - late_ns, quality, reason, place, velocity, heading)

    def of_sentence(self, sentence: Sentence, gps_ns: int) -> Solution:
        """`gps_ns`: when it is of."""
        quality, reason = judge_sentence(sentence)
        if quality is Quality.REFUSED:
            return Solution(sentence.kind, gps_ns, quality, reason)
        place = velocity = heading = None
        if sentence.kind == "GGA" and sentence.latitude is not None and sentence.longitude is not None:
            place = _unstated(sentence.latitude, sentence.longitude, None)
        if sentence.speed is not None and sentence.course is not None:
            velocity = _along(sentence.speed, sentence.course)
        if sentence.heading is not None:
            heading = Heading(yaw=_yaw(sentence.heading) - self._turned, std=None)
        return Solution(sentence.kind, gps_ns, quality, reason, place, velocity, heading)

    def _of_antennas(self, v: Values) -> Heading:
        return Heading(yaw=_yaw(v["heading"]) - self._turned, std=_deviation(math.radians(v["heading_std"])))

    def _increments(self, log: ReceiverLog, quality: Quality, reason: str) -> Solution | None:
        """Means since the log before; None of the first one."""
        elapsed_ns, self._increments_ns = log.gps_ns - self._increments_ns, log.gps_ns
        if not 0 < elapsed_ns <= INTERVAL_MAX_NS:
            return None
        return Solution(log.name, log.gps_ns, quality, reason, rates=_rates(log.values, NS_PER_S / elapsed_ns))


def _rates(v: Values, hz: float) -> Rates:
    """CORRIMUS: rad about x (right), y (ahead), z (up), and m/s along them, as rates."""
    return Rates(
        roll_rate=v["roll"] * hz, pitch_rate=-v["pitch"] * hz, yaw_rate=v["yaw"] * hz,
        ax=v["longitudinal"] * hz, ay=-v["lateral"] * hz, az=v["vertical"] * hz, std_rate=None, std_force=None,
    )  # fmt: skip


Parts = tuple[Place | None, Velocity | None, Heading | None]


def _bestpos(v: Values) -> Parts:
    return _place(v), None, None


def _bestvel(v: Values) -> Parts:
    return None, _along(v["speed"], v["track"], v["up"]), None


def _inspvax(v: Values) -> Parts:
    std = _deviation(max(v["std_speed_north"], v["std_speed_east"]))
    heading = Heading(yaw=_yaw(v["azimuth"]), std=_deviation(math.radians(v["std_azimuth"])))
    return _place(v), Velocity(east=v["east"], north=v["north"], up=v["up"], std=std), heading


def _inspvas(v: Values) -> Parts:
    velocity = Velocity(east=v["east"], north=v["north"], up=v["up"], std=None)
    place = _unstated(v["latitude"], v["longitude"], v["height_ellipsoidal"])
    return place, velocity, Heading(yaw=_yaw(v["azimuth"]), std=None)


PARTS: Mapping[str, Callable[[Values], Parts]] = {
    "BESTPOS": _bestpos, "BESTGNSSPOS": _bestpos, "BESTVEL": _bestvel, "BESTGNSSVEL": _bestvel,
    "INSPVAX": _inspvax, "INSPVAS": _inspvas,
}  # fmt: skip
MOTION = frozenset({*PARTS, *ANTENNAS, INCREMENTS})


def _place(v: Values) -> Place:
    east, north, up = (_deviation(v[f"std_{axis}"]) for axis in ("east", "north", "up"))
    height = v["height_msl"] + v["undulation"]
    return Place(
        latitude=v["latitude"], longitude=v["longitude"], height=height, std_east=east, std_north=north, std_up=up
    )


def _unstated(latitude: float, longitude: float, height: float | None) -> Place:
    return Place(latitude=latitude, longitude=longitude, height=height, std_east=None, std_north=None, std_up=None)


def _along(speed: float, track_deg: float, up: float | None = None) -> Velocity:
    track = math.radians(track_deg)
    return Velocity(east=speed * math.sin(track), north=speed * math.cos(track), up=up, std=None)


def _yaw(azimuth_deg: float) -> float:
    """rad from east, positive to the left, of an angle clockwise from north."""
    return math.remainder(0.5 * math.pi - math.radians(azimuth_deg), 2.0 * math.pi)


def _deviation(std: float) -> float | None:
    """None of a receiver that states none: 0."""
    return std if std > 0.0 else None
