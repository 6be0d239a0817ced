"""A whole CAN log, bus by bus: what each carries, how often against the DBC, and what is wrong with the log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from can_dbc.codec import Codec
from hil_gateway.can_link.monitor import FrameMonitor
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.reading import Log

OFF_PACE = 2.0
"""Factor by which most messages come more or less often than declared, from which on the clock is doubted."""


@dataclass(frozen=True)
class BusLog:
    """The buses of one log, by name; what was left out by kind, and notes in plain words."""

    buses: dict[str, FrameMonitor]
    left_out: Counter[str]
    notes: tuple[str, ...]


def read_buses(log: Log, codec: Codec, filters: Sequence[str] = (), channel: str | None = None) -> BusLog:
    """Take in a whole log, or one bus of it.

    Raises:
        InputError: unreadable, or no frames.
    """
    buses: dict[str, FrameMonitor] = {}
    for entry in log.frames():
        if channel not in (None, entry.channel):
            log.left_out["frame of another channel"] += 1
            continue
        if entry.channel not in buses:
            buses[entry.channel] = FrameMonitor(codec, filters)
        buses[entry.channel].take((entry.frame,))
    if not buses:
        raise InputError(f"{log.path}: holds no CAN frames{f' of channel {channel}' if channel else ''}")
    notes = [*log.notes, *(note for bus, view in buses.items() if (note := _off_pace(bus, view)))]
    return BusLog(dict(sorted(buses.items())), log.left_out, tuple(notes))


def _off_pace(bus: str, view: FrameMonitor) -> str:
    """What to say of a bus whose messages all come too often or too seldom."""
    ratios = [
        stream.rate_hz * stream.message.period_s
        for stream in view.streams.values()
        if stream.message is not None and stream.rate_hz is not None and stream.message.period_s > 0
    ]
    ratio = median(ratios) if len(ratios) > 1 else 1.0
    if 1.0 / OFF_PACE < ratio < OFF_PACE:
        return ""
    return f"{bus}: messages come {ratio:.3g} times as often as the DBC declares: are the times in another unit?"
