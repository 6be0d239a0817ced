"""What a receiver sends, and whether it may be used: the first look at a new one. Pure."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from hil_gateway.bus.outside import Quality
from hil_gateway.receiver.gates import judge
from hil_gateway.receiver.nmea import NmeaDecoder, Sentence
from hil_gateway.receiver.oem7 import Decoder, ReceiverLog

POSITIONS = frozenset({"BESTPOS", "BESTGNSSPOS", "INSPVAX", "INSPVAS"})


@dataclass
class _Seen:
    """Logs of one name."""

    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    """GPS time"""
    qualities: Counter[Quality] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)

    def add(self, log: ReceiverLog) -> None:
        at = 1e-9 * log.gps_ns
        self.first_s = self.first_s if self.count else at
        self.last_s, self.count = at, self.count + 1
        quality, reason = judge(log)
        self.qualities[quality] += 1
        if reason:
            self.reasons[reason] += 1

    @property
    def rate_hz(self) -> float | None:
        lasted = self.last_s - self.first_s
        return (self.count - 1) / lasted if lasted > 0 else None


class Check:
    """Takes bytes, counts logs; `report` is what was found."""

    def __init__(self) -> None:
        self._oem7, self._nmea = Decoder(), NmeaDecoder()
        self._logs: dict[str, _Seen] = {}
        self._sentences: Counter[str] = Counter()
        self._newest: Sentence | None = None

    def take(self, data: bytes) -> None:
        """Bytes as they arrived."""
        for log in self._oem7.take(data):
            self._logs.setdefault(log.name, _Seen()).add(log)
        for sentence in self._nmea.take(data):
            self._sentences[sentence.kind] += 1

    @property
    def usable(self) -> bool:
        """Whether a position came that may be used."""
        return any(self._logs[name].qualities[Quality.FIXED] for name in POSITIONS & self._logs.keys())

    def report(self) -> dict[str, Any]:
        """Counts, rates (by GPS time) and qualities of every log; what was damaged."""
        logs = {
            name: {
                "count": seen.count,
                "rate_hz": None if seen.rate_hz is None else round(seen.rate_hz, 2),
                **{str(quality): seen.qualities[quality] for quality in Quality},
                "reasons": dict(seen.reasons.most_common(3)),
            }
            for name, seen in sorted(self._logs.items())
        }
        damage = {"bad_crc": self._oem7.bad_crc, "other_logs": self._oem7.unknown, "other_bytes": self._oem7.skipped}
        nmea = {**dict(self._sentences), "bad_checksum": self._nmea.bad_checksum}
        return {"usable": self.usable, "logs": logs, "nmea": nmea, **damage}
