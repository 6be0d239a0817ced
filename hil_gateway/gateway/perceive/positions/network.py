"""Position fixes and headings of receivers on the network, brought up to the time of the vehicle state.

A fix is some time old when it arrives. Since then the car has gone on by the receiver's own velocity, turned by the
gyro and changed by the longitudinal force: within 0.1 s that is right to a few centimetres. A heading has turned with
the gyro. Where corrections are lost, under a bridge, the place goes on by the velocity of the receiver's inertial
solution, as far as the deviation that it states allows.
The receiver in use stays so while it places the car, then the first of the configuration that does.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from hil_gateway.bus.messages import Heading, SourceHealth
from hil_gateway.bus.outside import Navigation, Quality, Velocity
from hil_gateway.bus.topics import NAVIGATION
from hil_gateway.car.car import Receiver
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, UNSEEN_S
from hil_gateway.observer.bank import GATE
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

OLDEST_NS = round(UNSEEN_S * NS_PER_S)
"""of a fix that is brought up, and between it and its velocity: a race car changes its speed by 10 m/s in it"""
WALKING = 2.0
"""m/s from which the course of an antenna says where the car points, where no heading does"""
MISSING_NS = round(CONTRADICTED_S * NS_PER_S)
"""since the last fix: two of them are missing"""
POINTING = ("INSPVAX", "INSPVAS", "HEADING2", "DUALANTENNAHEADING", "HDT")
"""logs that say where the car points, best first: two of one receiver differ by how its parts are mounted"""
KEPT = round((UNSEEN_S + CONTRADICTED_S) / PERIOD_S)
"""periods: `OLDEST_NS`, and two fixes"""


@dataclass(slots=True)
class _Period:
    """One vehicle state: its time, and how the car has turned (rad) and gained speed (m/s) since the first one."""

    stamp_ns: int
    turned: float
    gained: float


class _Said(NamedTuple):
    """Velocity of a receiver's point, and of when it is."""

    stamp_ns: int
    velocity: Velocity


class _Moved:
    """How the car has moved in the last periods, by gyro and longitudinal force."""

    def __init__(self) -> None:
        self._periods: deque[_Period] = deque(maxlen=KEPT)

    def step(self, stamp_ns: int, ax: float, yaw_rate: float) -> None:
        """A new vehicle state; one that is no newer than the last changes nothing."""
        if not self._periods:
            self._periods.append(_Period(stamp_ns, 0.0, 0.0))
            return
        last = self._periods[-1]
        dt = (stamp_ns - last.stamp_ns) / NS_PER_S
        if dt > 0.0:
            self._periods.append(_Period(stamp_ns, last.turned + dt * yaw_rate, last.gained + dt * ax))

    def turned_since(self, then_ns: int) -> float:
        """By how much the car has turned, rad."""
        return self._periods[-1].turned - self._at(then_ns).turned

    def way_since(self, then_ns: int, said: _Said) -> tuple[float, float] | None:
        """Way from `then_ns` to the newest state, m in the map, of a point of which that was `said`; None where that is
        longer ago than is kept."""
        periods, velocity = self._periods, said.velocity
        if not periods or min(then_ns, said.stamp_ns) < periods[0].stamp_ns:
            return None
        known, speed = self._at(said.stamp_ns), math.hypot(velocity.east, velocity.north)
        course, east, north = math.atan2(velocity.north, velocity.east), 0.0, 0.0
        before = self._at(then_ns)
        for period in [p for p in periods if p.stamp_ns > then_ns]:
            dt = (period.stamp_ns - before.stamp_ns) / NS_PER_S
            middle = course + 0.5 * (before.turned + period.turned) - known.turned
            way = dt * (speed + 0.5 * (before.gained + period.gained) - known.gained)
            east, north, before = east + way * math.cos(middle), north + way * math.sin(middle), period
        return east, north

    def _at(self, then_ns: int) -> _Period:
        """At a time between two periods, or at the ends."""
        periods = self._periods
        after = next((i for i, period in enumerate(periods) if period.stamp_ns >= then_ns), len(periods) - 1)
        if after == 0:
            return periods[0]
        a, b = periods[after - 1], periods[after]
        share = min((then_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns), 1.0)
        turned, gained = a.turned + share * (b.turned - a.turned), a.gained + share * (b.gained - a.gained)
        return _Period(min(then_ns, b.stamp_ns), turned, gained)


class _Way(NamedTuple):
    """How far a receiver's point has gone by its velocities since its fix, m in the map, and with what error."""

    stamp_ns: int
    east: float = 0.0
    north: float = 0.0
    std: float = 0.0

    def by(self, before: _Said, after: _Said) -> _Way:
        """On to a later time by the velocities now and then, whose error lasts, so that it adds up."""
        dt, std = (after.stamp_ns - self.stamp_ns) / NS_PER_S, after.velocity.std
        if dt <= 0.0 or std is None:
            return self
        east = 0.5 * (before.velocity.east + after.velocity.east)
        north = 0.5 * (before.velocity.north + after.velocity.north)
        return _Way(after.stamp_ns, self.east + dt * east, self.north + dt * north, self.std + dt * std)


class _Newest:
    """What one receiver has said last that may be used."""

    def __init__(self, declared: Receiver) -> None:
        self.declared = declared
        self.fix: Navigation | None = None
        self.heading: Navigation | None = None
        self.came_ns: int | None = None
        """when the fix came"""
        self._velocities: deque[_Said] = deque(maxlen=KEPT)
        """that follow each other and state their deviation, but for the oldest one"""
        self._way: _Way | None = None
        """from the fix on, as far as velocities go on from it"""
        self.carried: _Way | None = None
        """the same to where the point is without a fix"""
        self.cause = "nothing has come: `hil receiver run`"

    @property
    def velocity(self) -> _Said | None:
        """The newest one."""
        return self._velocities[-1] if self._velocities else None

    def take(self, message: Navigation, now_ns: int) -> None:
        """The next message."""
        if message.places:
            self.cause = message.reason
        if message.velocity is not None and self._is_better(message.stamp_ns, message.velocity):
            self._go_on(_Said(message.stamp_ns, message.velocity), now_ns)
        if message.quality is not Quality.FIXED:
            return
        self.heading = message if self._points_better(message) else self.heading
        if message.places and self._has_velocity(message):
            self._begin(message, now_ns)

    def _begin(self, fix: Navigation, now_ns: int) -> None:
        """A new fix, since which the point has gone on already by the velocities that came before it."""
        self.fix, self.came_ns, self.carried = fix, now_ns, None
        way = _Way(fix.stamp_ns)
        for before, after in pairwise(self._velocities):
            way = way.by(before, after)
        self._way = way if self._velocities[0].stamp_ns <= fix.stamp_ns else None

    def _go_on(self, said: _Said, now_ns: int) -> None:
        """The next velocity; one that states no deviation carries nothing."""
        before = self.velocity
        if before is None or said.velocity.std is None or not 0 < said.stamp_ns - before.stamp_ns <= OLDEST_NS:
            self._velocities.clear()
            self._way = self.carried = None
        elif self._way is not None:
            self._way = self._way.by(before, said)
            self._carry(self._way, now_ns)
        self._velocities.append(said)

    def _carry(self, way: _Way, now_ns: int) -> None:
        """The place goes on from its fix, where fixes are missing, as far as one of fixed quality may be off: the state
        filter takes the next fix all the same."""
        fixed_ns = 0 if self.fix is None else self.fix.stamp_ns
        before_ns = fixed_ns if self.carried is None else self.carried.stamp_ns
        due = way.stamp_ns - fixed_ns > MISSING_NS and way.stamp_ns - before_ns >= MISSING_NS // 2
        if due and way.std <= GATE * self.declared.noise:
            self.carried, self.came_ns = way, now_ns

    def _has_velocity(self, fix: Navigation) -> bool:
        """Whether the fix can be brought up; one that cannot does not place the car, and the next receiver may."""
        near = self.velocity is not None and abs(self.velocity.stamp_ns - fix.stamp_ns) <= OLDEST_NS
        self.cause = self.cause if near else "no velocity comes with its positions: log BESTVEL or RMC too"
        return near

    def _is_better(self, stamp_ns: int, velocity: Velocity) -> bool:
        """Of velocities, those that state their deviation: others are means of a whole interval, and late by half."""
        old = self.velocity
        if old is None or old.velocity.std is None or velocity.std is not None:
            return True
        return stamp_ns - old.stamp_ns > OLDEST_NS

    def _points_better(self, message: Navigation) -> bool:
        """Whether its heading is of the best log that has said one lately."""
        old = self.heading
        if message.heading is None or message.log not in POINTING:
            return False
        late = old is None or message.stamp_ns - old.stamp_ns > OLDEST_NS
        return late or old is None or POINTING.index(message.log) <= POINTING.index(old.log)


class NetworkReceivers:
    """`take` what arrives, then once a period `step`, then `heading`."""

    def __init__(self, config: Config) -> None:
        declared = config.car.network_receivers
        self._newest = {name: _Newest(declared[name]) for name in config.receivers}
        self._moved, self._used, self._pointed = _Moved(), (0, ""), (0, "")
        self.name = next(iter(self._newest), "")
        """the receiver in use; empty where none is configured"""

    def __bool__(self) -> bool:
        return bool(self._newest)

    def take(self, messages: Iterable[Navigation], now_ns: int) -> None:
        """Messages of the receivers, oldest first; what is not of this computer's clock is left out."""
        for message in messages:
            newest = self._newest.get(message.source)
            if newest is not None and 0 <= now_ns - message.stamp_ns <= NS_PER_S:
                newest.take(message, now_ns)

    def healths(self, now_ns: int) -> dict[str, SourceHealth]:
        """Of the receiver in use as `position`; where there are several, each beside it."""
        found = {name: _health(newest.came_ns, now_ns) for name, newest in self._newest.items()}
        if not found[self.name].valid:
            self.name = next((name for name, health in found.items() if health.valid), self.name)
        each = {f"receiver.{name}": health for name, health in found.items()} if len(found) > 1 else {}
        return {"position": found[self.name], **each}

    @property
    def cause(self) -> str:
        """Why they do not place the car, of each."""
        return "; ".join(f"{name}: {newest.cause or 'silent'}" for name, newest in self._newest.items())

    def step(self, stamp_ns: int, ax: float, yaw_rate: float) -> tuple[float, float, float, float] | None:
        """Fix of the receiver in use that has come since the last call, as latitude and longitude (deg) of the point it
        reports and the way (m, map) from there to the centre of gravity at `stamp_ns`."""
        self._moved.step(stamp_ns, ax, yaw_rate)
        newest = self._newest[self.name]
        fix, said = newest.fix, newest.velocity
        if fix is None or fix.place is None or said is None:
            return None
        then = newest.carried or _Way(fix.stamp_ns)
        if (then.stamp_ns, self.name) == self._used:
            return None
        self._used = then.stamp_ns, self.name
        way = self._moved.way_since(then.stamp_ns, said)
        if way is None or stamp_ns - then.stamp_ns > OLDEST_NS:
            return None
        ahead, left = self._lever(newest, said)
        return fix.place.latitude, fix.place.longitude, then.east + way[0] - ahead, then.north + way[1] - left

    def heading(self, stamp_ns: int) -> Heading | None:
        """Of the receiver in use, turned on to `stamp_ns`; None where none has come since the last call."""
        newest = self._newest[self.name].heading
        if newest is None or newest.heading is None or (newest.stamp_ns, self.name) == self._pointed:
            return None
        self._pointed = newest.stamp_ns, self.name
        if stamp_ns - newest.stamp_ns > OLDEST_NS:
            return None
        return Heading(yaw=newest.heading.yaw + self._moved.turned_since(newest.stamp_ns), std=newest.heading.std)

    def _lever(self, newest: _Newest, said: _Said) -> tuple[float, float]:
        """From the centre of gravity to the point that the receiver reports, m in the map; none where the car points
        nobody knows."""
        heading, velocity = newest.heading, said.velocity
        if heading is not None and heading.heading is not None and abs(heading.stamp_ns - said.stamp_ns) < OLDEST_NS:
            yaw = heading.heading.yaw + self._moved.turned_since(heading.stamp_ns)
        elif math.hypot(velocity.east, velocity.north) > WALKING:
            yaw = math.atan2(velocity.north, velocity.east) + self._moved.turned_since(said.stamp_ns)
        else:
            return 0.0, 0.0
        x, y, c, s = newest.declared.x, newest.declared.y, math.cos(yaw), math.sin(yaw)
        return c * x - s * y, s * x + c * y


def _health(came_ns: int | None, now_ns: int) -> SourceHealth:
    if came_ns is None:
        return SourceHealth(age_s=None, valid=False)
    age_s = (now_ns - came_ns) / NS_PER_S
    return SourceHealth(age_s=age_s, valid=age_s <= NAVIGATION.deadline_s)
