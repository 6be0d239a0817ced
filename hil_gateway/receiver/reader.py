"""One receiver: bytes to what may be used of them, each with its time by this computer's clock. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from hil_gateway.bus.outside import Navigation, Quality, ReceiverHealth
from hil_gateway.car.car import Receiver
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.receiver.clock import GpsClock
from hil_gateway.receiver.continuity import Continuity
from hil_gateway.receiver.nmea import NmeaDecoder, Sentence
from hil_gateway.receiver.oem7 import Decoder, ReceiverLog
from hil_gateway.receiver.solution import Solution, Solutions
from hil_gateway.settings.receivers import ReceiverConfig

PLACING = ("BESTPOS", "BESTGNSSPOS", "GGA", "INSPVAX", "INSPVAS")
"""logs with a position; the first of them that comes places the car: those of an inertial filter follow each other"""
OFTEN_NS = NS_PER_S // 20
"""positions of one receiver are at least so far apart: nearer ones share their error"""
SILENT_NS = NS_PER_S // 2
"""without a position that may be used, after which the receiver does not place the car: ten of 20 Hz"""
MOST_A_SECOND = 1000
"""messages: five logs at 200 Hz, the most that an OEM7 sends; what is beyond is left out and counted"""
REASONS_MAX = 32
"""that are counted by name"""
EARLY_NS = NS_PER_S // 200
"""by which a position may come before it is due: times of logs are rounded to milliseconds"""
LEAP_MAX_S = 60
LATEST_NS = 1 << 62
"""GPS time in ns, of the year 2126"""
DAY_NS = 86_400 * NS_PER_S


class Reader:
    """`take` what arrives, in order; `health` says how it is."""

    def __init__(self, name: str, config: ReceiverConfig, declared: Receiver) -> None:
        self._name = name
        self._oem7, self._nmea, self._solutions = Decoder(), NmeaDecoder(), Solutions(declared)
        self._continuity, self._clock = Continuity(), GpsClock(config, declared.delay)
        self._seq = self._logs = self._damaged = self.connections = 0
        self._refused: Counter[str] = Counter()
        self._second_ns, self._room = -NS_PER_S, 0
        self._came_ns: dict[str, int] = {}
        """when the newest log came of each kind that places"""
        self._utc_ns: int | None = None
        """of the newest sentence that says it"""
        self._placed_ns = self._placed_gps_ns = 0
        self._reason, self._late_s = "no position has come", 0.0
        self.broken = "not connected yet"
        """why no bytes arrive; empty: they may"""

    def begin(self) -> None:
        """A stream begins: what is left of the last one does not belong to it."""
        self._damaged = self.damaged
        self._oem7, self._nmea, self.broken = Decoder(), NmeaDecoder(), ""
        self.connections += 1

    @property
    def damaged(self) -> int:
        """Logs and sentences with a wrong checksum."""
        return self._damaged + self._oem7.bad_crc + self._nmea.bad_checksum

    def take(self, data: bytes, now_ns: int, unix_offset_ns: int) -> list[Navigation]:
        """Messages of what `data` completes, which arrived now (monotonic, ns); `unix_offset_ns` makes Unix time of
        it."""
        read = self._read(data, now_ns + unix_offset_ns)
        return [self._message(solution, now_ns, unix_offset_ns) for solution in read if self._has_room(now_ns)]

    def _read(self, data: bytes, unix_ns: int) -> Iterator[Solution]:
        for log in self._oem7.take(data):
            yield from self._of_log(log)
        for sentence in self._nmea.take(data):
            yield from self._of_sentence(sentence, unix_ns)

    def _of_log(self, log: ReceiverLog) -> Iterator[Solution]:
        if log.name == "TIME" and log.values["clock_status"] == 0 and 0.0 < -log.values["utc_offset_s"] < LEAP_MAX_S:
            self._clock.leap_s = round(-log.values["utc_offset_s"])
        try:
            solution = self._solutions.of_log(log)
        except ValueError:
            solution = Solution(log.name, log.gps_ns, Quality.REFUSED, "a value is out of range")
        if solution is not None:
            in_range = 0 <= solution.gps_ns < LATEST_NS
            yield solution if in_range else Solution(log.name, 0, Quality.REFUSED, "its time is out of range")

    def _of_sentence(self, sentence: Sentence, unix_ns: int) -> Iterator[Solution]:
        """One without a time is of that of the sentence before."""
        self._utc_ns = _utc_ns(sentence.utc, unix_ns) or self._utc_ns
        if self._utc_ns is None:
            return
        gps_ns = self._clock.gps_ns(self._utc_ns)
        try:
            yield self._solutions.of_sentence(sentence, gps_ns)
        except ValueError:
            yield Solution(sentence.kind, gps_ns, Quality.REFUSED, "a value is out of range")

    def _has_room(self, now_ns: int) -> bool:
        if now_ns - self._second_ns >= NS_PER_S:
            self._second_ns, self._room = now_ns, MOST_A_SECOND
        self._room -= 1
        if self._room < 0:
            self._count(f"more than {MOST_A_SECOND} a second")
        return self._room >= 0

    def _count(self, reason: str) -> None:
        """A refusal; reasons have numbers of the receiver in them, and are as many as it likes."""
        known = reason in self._refused or len(self._refused) < REASONS_MAX
        self._refused[reason if known else "other reasons"] += 1

    def _message(self, solution: Solution, now_ns: int, unix_offset_ns: int) -> Navigation:
        stamp_ns, late = self._clock.stamp(solution.gps_ns, now_ns, unix_offset_ns)
        refusal = solution.reason if solution.quality is Quality.REFUSED else self._continuity.judge(solution) or late
        quality, reason = (Quality.REFUSED, refusal) if refusal else (solution.quality, solution.reason)
        self._logs, self._seq = self._logs + 1, self._seq + 1
        self._late_s = (now_ns - stamp_ns) / NS_PER_S
        if refusal:
            self._count(refusal)
        return Navigation(
            stamp_ns=stamp_ns, seq=self._seq - 1, source=self._name, log=solution.log, quality=quality, reason=reason,
            gps_ns=solution.gps_ns, late_s=self._late_s,
            places=self._places(solution, quality, reason, now_ns),
            **({} if refusal else _parts(solution)),
        )  # fmt: skip

    def _places(self, solution: Solution, quality: Quality, reason: str, now_ns: int) -> bool:
        """Whether it is the log that places the car, and how it does."""
        if solution.log not in PLACING:
            return False
        self._came_ns[solution.log] = now_ns
        if next(log for log in PLACING if now_ns - self._came_ns.get(log, -SILENT_NS) < SILENT_NS) != solution.log:
            return False
        if 0 <= solution.gps_ns - self._placed_gps_ns < OFTEN_NS - EARLY_NS:
            return False
        self._placed_gps_ns, self._reason = solution.gps_ns, reason
        if quality is Quality.FIXED:
            self._placed_ns = now_ns
        return True

    def cause(self, now_ns: int) -> str:
        """Why it does not place the car now; empty: it does."""
        if self.broken:
            return self.broken
        silent = now_ns - self._placed_ns > SILENT_NS or not self._placed_ns
        return (self._reason or "no position comes any more") if silent else ""

    def health(self, now_ns: int) -> ReceiverHealth:
        """How it is now."""
        return ReceiverHealth(
            connected=not self.broken,
            cause=self.cause(now_ns),
            late_s=self._late_s if self._logs else None,
            clock_s=self._clock.offset_s,
            leap_s=self._clock.leap_s,
            logs=self._logs,
            refused=dict(self._refused),
            damaged=self.damaged,
            connections=self.connections,
        )


def _parts(solution: Solution) -> dict[str, Any]:
    return {
        "place": solution.place, "velocity": solution.velocity, "heading": solution.heading, "rates": solution.rates
    }  # fmt: skip


def _utc_ns(text: str, unix_ns: int) -> int | None:
    """Unix time of hhmmss.ss, of the day on which it is nearest to `unix_ns`; None where it is no time."""
    clock, _, fraction = text.partition(".")
    if len(clock) != len("hhmmss") or not (clock + fraction).isdecimal():
        return None
    of_day_ns = (int(clock[:2]) * 3600 + int(clock[2:4]) * 60 + int(clock[4:])) * NS_PER_S
    of_day_ns += round(float(f"0.{fraction or 0}") * NS_PER_S)
    return unix_ns - (unix_ns - of_day_ns + DAY_NS // 2) % DAY_NS + DAY_NS // 2
