"""Position fixes and headings of receivers on the network, brought up to the time of the vehicle state.

A fix is some time old when it arrives. Since then the car has gone on by the receiver's own velocity, turned by the
gyro and changed by the longitudinal force: within 0.1 s that is right to a few centimetres. A heading has turned with
the gyro. Where corrections are lost, under a bridge, the place goes on by the velocity of the receiver's inertial
solution, as far as the deviation that it states allows.
The receiver in use stays so while it places the car, then the first of the configuration that does.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil_gateway.bus.messages import Heading, SourceHealth
from hil_gateway.bus.outside import Navigation, Quality
from hil_gateway.bus.topics import NAVIGATION
from hil_gateway.car.car import Receiver
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, UNSEEN_S
from hil_gateway.observer.bank import GATE
from hil_gateway.process.arrays import Array
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


class _Said(NamedTuple):
    """Velocity of a receiver's point in the map, m/s (x + i y), and of when it is."""

    stamp_ns: int
    velocity: complex
    std: float | None


class _Moved:
    """How the car has moved in the last periods, by gyro and longitudinal force."""

    def __init__(self) -> None:
        self._periods: deque[tuple[int, float, float]] = deque(maxlen=KEPT)
        """stamp of a vehicle state, and how the car has turned (rad) and gained speed (m/s) since the first one"""

    def step(self, stamp_ns: int, ax: float, yaw_rate: float) -> None:
        """A new vehicle state; one that is no newer than the last changes nothing."""
        if not self._periods:
            self._periods.append((stamp_ns, 0.0, 0.0))
        last_ns, turned, gained = self._periods[-1]
        dt = (stamp_ns - last_ns) / NS_PER_S
        if dt > 0.0:
            self._periods.append((stamp_ns, turned + dt * yaw_rate, gained + dt * ax))

    def turned_since(self, then_ns: int) -> float:
        """By how much the car has turned, rad."""
        stamps, turned, _ = np.array(self._periods).T
        return float(turned[-1] - np.interp(then_ns, stamps, turned))

    def way_since(self, then_ns: int, said: _Said) -> complex | None:
        """Way from `then_ns` to the newest state, m in the map, of a point of which that was `said`; None where that is
        longer ago than is kept."""
        if not self._periods or min(then_ns, said.stamp_ns) < self._periods[0][0]:
            return None
        stamps, *turned_gained = np.array(self._periods).T
        times = np.array([then_ns, *stamps[stamps > then_ns]])
        turns, gains = (
            _middles(np.interp(times, stamps, since)) - np.interp(said.stamp_ns, stamps, since)
            for since in turned_gained
        )
        speed, course = cmath.polar(said.velocity)
        return complex((np.diff(times) / NS_PER_S * (speed + gains) * np.exp(1j * (course + turns))).sum())


def _middles(values: Array) -> Array:
    return 0.5 * (values[1:] + values[:-1])


class _Way(NamedTuple):
    """How far a receiver's point has gone by its velocities since its fix, m in the map, and with what error."""

    stamp_ns: int
    gone: complex = 0j
    std: float = 0.0

    def by(self, before: _Said, after: _Said) -> _Way:
        """On to a later time by the velocities now and then, whose error lasts, so that it adds up."""
        dt = (after.stamp_ns - self.stamp_ns) / NS_PER_S
        if dt <= 0.0 or after.std is None:
            return self
        middle = 0.5 * (before.velocity + after.velocity)
        return _Way(after.stamp_ns, self.gone + dt * middle, self.std + dt * after.std)


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
        if (given := message.velocity) is not None:
            self._go_on(_Said(message.stamp_ns, complex(given.east, given.north), given.std), now_ns)
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
        """The next velocity. One that states no deviation carries nothing, and is left out where others state theirs:
        it is the mean of a whole interval, and late by half."""
        before = self.velocity
        since_ns = math.inf if before is None else said.stamp_ns - before.stamp_ns
        if said.std is None and before is not None and before.std is not None and since_ns <= OLDEST_NS:
            return
        if before is None or said.std is None or not 0 < since_ns <= OLDEST_NS:
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
        place = then.gone + way - self._lever(newest, said)
        return fix.place.latitude, fix.place.longitude, place.real, place.imag

    def heading(self, stamp_ns: int) -> Heading | None:
        """Of the receiver in use, turned on to `stamp_ns`; None where none has come since the last call."""
        newest = self._newest[self.name].heading
        if newest is None or newest.heading is None or (newest.stamp_ns, self.name) == self._pointed:
            return None
        self._pointed = newest.stamp_ns, self.name
        if stamp_ns - newest.stamp_ns > OLDEST_NS:
            return None
        return Heading(yaw=newest.heading.yaw + self._moved.turned_since(newest.stamp_ns), std=newest.heading.std)

    def _lever(self, newest: _Newest, said: _Said) -> complex:
        """From the centre of gravity to the point that the receiver reports, m in the map; none where the car points
        nobody knows."""
        heading = newest.heading
        if heading is not None and heading.heading is not None and abs(heading.stamp_ns - said.stamp_ns) < OLDEST_NS:
            yaw = heading.heading.yaw + self._moved.turned_since(heading.stamp_ns)
        elif abs(said.velocity) > WALKING:
            yaw = cmath.phase(said.velocity) + self._moved.turned_since(said.stamp_ns)
        else:
            return 0j
        return cmath.rect(1.0, yaw) * complex(newest.declared.x, newest.declared.y)


def _health(came_ns: int | None, now_ns: int) -> SourceHealth:
    if came_ns is None:
        return SourceHealth(age_s=None, valid=False)
    age_s = (now_ns - came_ns) / NS_PER_S
    return SourceHealth(age_s=age_s, valid=age_s <= NAVIGATION.deadline_s)
