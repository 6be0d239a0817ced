"""When a log is of, by the clock of the computer that reads it. Pure.

GPS time counts on through leap seconds, UTC does not. Where this computer's clock keeps GPS time, a log's age is
measured. Else the fastest logs of the last seconds are as old as the car folder says, and what is late beyond them is
measured: clocks drift apart too slowly to matter within that time.
"""

from __future__ import annotations

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.receiver.oem7 import GPS_EPOCH_UNIX_S
from hil_gateway.settings.receivers import ReceiverConfig

LEAP_S = 18
"""GPS less UTC since 2017 (IERS Bulletin C); a receiver that sends TIME logs says it itself"""
WINDOW_NS = 10 * NS_PER_S
"""in which the fastest log counts; two quartzes drift apart by 1 ms in it at 100 ppm"""
EARLY_MAX_NS = 5_000_000
"""by which a log may be of the future: what PTP or NTP in one network leaves"""
LATE_MAX_NS = NS_PER_S // 2
"""older, a log is of no use at speed: a car has gone 30 m"""


class GpsClock:
    """Stamps of one receiver's logs."""

    def __init__(self, by: ReceiverConfig, delay_s: float) -> None:
        """`delay_s`: of the fastest logs, where nothing measures it."""
        self._measured, self._delay_ns = by.clock == "gps", round(delay_s * NS_PER_S)
        self.leap_s = LEAP_S
        self.offset_s: float | None = None
        """this computer's clock ahead of GPS time, by the newest log, its delay included"""
        self._began_ns: int | None = None
        self._before = self._least = 0
        """least arrival less GPS time of the last whole window and of this one, ns"""

    def stamp(self, gps_ns: int, arrived_ns: int, unix_offset_ns: int) -> tuple[int, str]:
        """Monotonic stamp (ns) of a log that arrived then, and why it is not to be believed; empty: it is."""
        ahead_ns = arrived_ns + unix_offset_ns - self.unix_ns(gps_ns)
        self.offset_s = ahead_ns / NS_PER_S
        late_ns = ahead_ns if self._measured else self._beyond_fastest(arrived_ns - gps_ns, arrived_ns) + self._delay_ns
        if late_ns < -EARLY_MAX_NS or (self._measured and late_ns > LATE_MAX_NS):
            return arrived_ns, f"this computer's clock is {_rounded(late_ns)} s ahead of GPS time"
        if late_ns > LATE_MAX_NS:
            return arrived_ns, f"{_rounded(late_ns)} s late"
        return max(arrived_ns - late_ns, 0), ""

    def unix_ns(self, gps_ns: int) -> int:
        """Unix time of a GPS time."""
        return gps_ns + (GPS_EPOCH_UNIX_S - self.leap_s) * NS_PER_S

    def gps_ns(self, unix_ns: int) -> int:
        """GPS time of a Unix time."""
        return unix_ns - (GPS_EPOCH_UNIX_S - self.leap_s) * NS_PER_S

    def _beyond_fastest(self, difference_ns: int, now_ns: int) -> int:
        """How much later a log is than the fastest one, ns."""
        if self._began_ns is None or difference_ns < self._least - LATE_MAX_NS:  # the receiver's clock has been set
            self._began_ns, self._before = now_ns, difference_ns
            self._least = difference_ns
        elif now_ns - self._began_ns > WINDOW_NS:
            self._began_ns, self._before, self._least = now_ns, self._least, difference_ns
        self._least = min(self._least, difference_ns)
        return difference_ns - min(self._before, self._least)


def _rounded(ns: int) -> str:
    """Few different texts: they are counted by name."""
    return f"{ns / NS_PER_S:.1g}"
