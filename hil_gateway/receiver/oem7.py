"""NovAtel OEM7 binary logs out of a stream of bytes. Pure.

Source: OEM7 Commands and Logs Reference Manual: headers of 28 (AA 44 12) and 12 bytes (AA 44 13), CRC-32 behind. Text
between logs, prompts and garbage are skipped. Angles in deg, azimuth clockwise from true north; heights in m.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from struct import Struct

SYNC = b"\xaa\x44"
LONG, SHORT = 0x12, 0x13
LONG_HEADER = Struct("<3sBHBBHHBBHIIHH")
SHORT_HEADER = Struct("<3sBHHI")
CRC_BYTES = 4
BODY_MAX = 4096
"""bytes; the logs that are read have at most 126"""
GPS_EPOCH_UNIX_S = 315_964_800
WEEK_S = 604_800
PORT = 0x20
"""COM1; nobody looks at it"""
FINE = 160
"""least time status of a receiver whose clock is set (FINE; normally FINESTEERING, 180)"""


@dataclass(frozen=True, slots=True)
class LogLayout:
    """Body of a log: struct and names of its fields, the rest is padding. Longer bodies of later firmware pass."""

    name: str
    struct: Struct
    fields: tuple[str, ...]


def _layout(name: str, code: str, fields: str) -> LogLayout:
    return LogLayout(name, Struct(code), tuple(fields.split()))


_POSITION = (
    "solution_status position_type latitude longitude height_msl undulation datum std_north std_east std_up "
    "differential_age_s solution_age_s satellites satellites_used"
)
_VELOCITY = "solution_status velocity_type latency_s differential_age_s speed track up"
_HEADING = "solution_status position_type baseline heading pitch heading_std pitch_std"
LOGS: Mapping[int, LogLayout] = {
    42: _layout("BESTPOS", "<IIdddfIfff4xffBB6x", _POSITION),
    1429: _layout("BESTGNSSPOS", "<IIdddfIfff4xffBB6x", _POSITION),
    99: _layout("BESTVEL", "<IIffddd4x", _VELOCITY),
    1430: _layout("BESTGNSSVEL", "<IIffddd4x", _VELOCITY),
    1335: _layout("HEADING2", "<IIfff4xff16x", _HEADING),
    2042: _layout("DUALANTENNAHEADING", "<IIfff4xff12x", _HEADING),
    508: _layout(
        "INSPVAS", "<IddddddddddI",
        "week seconds latitude longitude height_ellipsoid north east up roll pitch azimuth ins_status",
    ),
    1465: _layout(
        "INSPVAX", "<IIdddfddddddfffffffffIH",
        "ins_status position_type latitude longitude height_msl undulation north east up roll pitch azimuth std_north "
        "std_east std_up std_speed_north std_speed_east std_speed_up std_roll std_pitch std_azimuth extended age_s",
    ),
    2264: _layout("CORRIMUS", "<Iddddddf4x", "samples pitch roll yaw lateral longitudinal vertical latency_ms"),
    1362: _layout("IMURATECORRIMUS", "<Iddddddd", "week seconds pitch roll yaw lateral longitudinal vertical"),
    1462: _layout(
        "RAWIMUSX", "<BBHdIiiiiii",
        "imu_error imu_type week seconds imu_status accel_z accel_minus_y accel_x gyro_z gyro_minus_y gyro_x",
    ),
    101: _layout("TIME", "<Iddd16x", "clock_status offset_s offset_std_s utc_offset_s"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class ReceiverLog:
    """One decoded log."""

    name: str
    week: int
    milliseconds: int
    """of the GPS week"""
    time_status: int
    """of this log, or of the last one with a long header; 0: none came yet"""
    values: Mapping[str, float]

    @property
    def gps_ns(self) -> int:
        """GPS time, ns since 1980-01-06, leap seconds not counted."""
        return (self.week * WEEK_S * 1000 + self.milliseconds) * 1_000_000


class Decoder:
    """Takes bytes as they come; `take` gives the logs that are complete."""

    def __init__(self) -> None:
        self._buffer = b""
        self._time_status = 0
        self.bad_crc = self.unknown = self.skipped = 0
        """logs that arrived damaged, logs of other kinds, bytes that were no log"""

    def take(self, data: bytes) -> Iterator[ReceiverLog]:
        """Logs completed by `data`."""
        self._buffer += data
        while (start := self._find_sync()) >= 0:
            self._skip(start)
            length = self._frame_length()
            if length is None or len(self._buffer) < length:
                return
            if length == 0 or not _crc_fits(self._buffer[:length]):
                self.bad_crc += length > 0
                self._skip(len(SYNC))  # not the claimed length, which may be what is damaged
                continue
            frame, self._buffer = self._buffer[:length], self._buffer[length:]
            if (log := self._decode(frame)) is not None:
                yield log

    def _find_sync(self) -> int:
        start = self._buffer.find(SYNC)
        if start < 0:
            self._skip(len(self._buffer) - self._buffer.endswith(SYNC[:1]))
        return start

    def _skip(self, count: int) -> None:
        self.skipped += count
        self._buffer = self._buffer[count:]

    def _frame_length(self) -> int | None:
        """Bytes with header and CRC; None before they are known, 0 where this is no log."""
        buffer = self._buffer
        if len(buffer) < SHORT_HEADER.size:
            return None
        if buffer[2] == SHORT:
            return SHORT_HEADER.size + buffer[3] + CRC_BYTES
        if buffer[2] != LONG or buffer[3] != LONG_HEADER.size:
            return 0
        body = int.from_bytes(buffer[8:10], "little")
        return LONG_HEADER.size + body + CRC_BYTES if body <= BODY_MAX else 0

    def _decode(self, frame: bytes) -> ReceiverLog | None:
        if frame[2] == LONG:
            header = LONG_HEADER.unpack_from(frame)
            number, self._time_status, week, milliseconds = header[2], header[8], header[9], header[10]
            body = frame[LONG_HEADER.size : -CRC_BYTES]
        else:
            _, _, number, week, milliseconds = SHORT_HEADER.unpack_from(frame)
            body = frame[SHORT_HEADER.size : -CRC_BYTES]
        layout = LOGS.get(number)
        if layout is None or len(body) < layout.struct.size:
            self.unknown += 1
            return None
        values = dict(zip(layout.fields, layout.struct.unpack_from(body), strict=True))
        return ReceiverLog(layout.name, week, milliseconds, self._time_status, values)


NUMBERS = {layout.name: number for number, layout in LOGS.items()}
SHORT_LOGS = ("INSPVAS", "CORRIMUS", "IMURATECORRIMUS", "RAWIMUSX")


def encode(log: ReceiverLog) -> bytes:
    """A log as a receiver sends it; fields without a value are 0."""
    number, layout = NUMBERS[log.name], LOGS[NUMBERS[log.name]]
    body = layout.struct.pack(*(log.values.get(name, 0) for name in layout.fields))
    if log.name in SHORT_LOGS:
        head = SHORT_HEADER.pack(SYNC + bytes([SHORT]), len(body), number, log.week, log.milliseconds)
    else:
        sync, size = SYNC + bytes([LONG]), LONG_HEADER.size
        head = LONG_HEADER.pack(
            sync, size, number, 0, PORT, len(body), 0, 0, log.time_status, log.week, log.milliseconds, 0, 0, 0
        )
    return head + body + crc32(head + body).to_bytes(CRC_BYTES, "little")


def crc32(data: bytes) -> int:
    """NovAtel's: reflected polynomial EDB88320, begins with 0, nothing inverted at the end."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _crc_fits(frame: bytes) -> bool:
    return crc32(frame[:-CRC_BYTES]) == int.from_bytes(frame[-CRC_BYTES:], "little")
