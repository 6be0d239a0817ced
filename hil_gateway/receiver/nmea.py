"""NMEA 0183 sentences GGA, RMC and HDT out of a stream of bytes. Pure.

Without deviations of its own a sentence says less than a binary log: HDOP is no deviation, and none is made of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

SENTENCE_MAX = 256
"""bytes; the standard allows 82, receivers with many digits send some more"""
KINDS = (b"GGA", b"RMC", b"HDT")
KNOTS = 1852 / 3600
"""m/s"""


@dataclass(frozen=True, slots=True)
class Sentence:
    """One sentence; what it does not say is None. Angles in deg, heading and course clockwise from true north."""

    kind: str
    utc: str
    """hhmmss.ss, as sent"""
    latitude: float | None = None
    longitude: float | None = None
    quality: int | None = None
    """GGA: 0 none, 1 single, 2 differential, 4 RTK fixed, 5 RTK float"""
    speed: float | None = None
    course: float | None = None
    heading: float | None = None


class NmeaDecoder:
    """Takes bytes as they come; sentences with a wrong checksum are counted and left out."""

    def __init__(self) -> None:
        self._buffer = b""
        self.bad_checksum = 0

    def take(self, data: bytes) -> Iterator[Sentence]:
        """Sentences completed by `data`."""
        *lines, rest = (self._buffer + data).split(b"\n")
        self._buffer = rest[-SENTENCE_MAX:]
        for line in lines:
            start = line.rfind(b"$")
            if start >= 0 and len(line) - start <= SENTENCE_MAX and (sentence := self._read(line[start + 1 :].strip())):
                yield sentence

    def _read(self, line: bytes) -> Sentence | None:
        body, star, given = line.partition(b"*")
        if body.partition(b",")[0][2:] not in KINDS:  # others, and pieces of binary logs
            return None
        checksum = 0
        for byte in body:
            checksum ^= byte
        try:
            if not star or int(given, 16) != checksum:
                raise ValueError
            kind, *fields = body.decode("ascii").split(",")
            return _sentence(kind[-3:], fields)
        except (ValueError, IndexError):
            self.bad_checksum += 1
            return None


def _sentence(kind: str, fields: list[str]) -> Sentence | None:
    if kind == "GGA":
        latitude, longitude = _angle(fields[1], fields[2]), _angle(fields[3], fields[4])
        return Sentence(kind, fields[0], latitude, longitude, quality=int(fields[5] or 0))
    if kind == "RMC":
        latitude, longitude = _angle(fields[2], fields[3]), _angle(fields[4], fields[5])
        speed = None if not fields[6] else float(fields[6]) * KNOTS
        valid = int(fields[1] == "A")
        return Sentence(kind, fields[0], latitude, longitude, valid, speed, float(fields[7]) if fields[7] else None)
    if kind == "HDT":
        return Sentence(kind, "", heading=float(fields[0]) if fields[0] else None)
    return None


def _angle(text: str, side: str) -> float | None:
    """ddmm.mmmm and N, S, E or W as deg."""
    if not text:
        return None
    whole, minutes = divmod(float(text), 100)
    return (whole + minutes / 60) * (-1 if side in ("S", "W") else 1)
