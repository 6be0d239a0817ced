"""Decoders of receivers: against NovAtel's own decoder, on real captures, on damaged bytes, over TCP."""

from __future__ import annotations

import json
import random
import socket
import struct
import threading
import zlib
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from hil_gateway.bus.outside import Quality
from hil_gateway.cli.receiver import app
from hil_gateway.receiver.clock import GpsClock
from hil_gateway.receiver.gates import judge
from hil_gateway.receiver.nmea import NmeaDecoder
from hil_gateway.receiver.oem7 import Decoder, ReceiverLog, crc32
from hil_gateway.settings.receivers import ReceiverConfig

SAME = {
    "latitude": "latitude", "longitude": "longitude", "undulation": "undulation", "azimuth": "azimuth",
    "std_north": "latitude_std_dev", "north": "north_vel", "roll": "roll", "speed": "horizontal_speed",
    "utc_offset_s": "utc_offset", "lateral": "lateral",
    "std_azimuth": "azimuth_std_dev",
}  # fmt: skip
"""our name of a field -> NovAtel's"""


def log_bytes(number: int, body: bytes, week: int = 2400, ms: int = 1000, time_status: int = 180) -> bytes:
    """A log with a long header, packed by hand from NovAtel's table."""
    header = struct.pack(
        "<3sBHBBHHBBHIIHH", b"\xaa\x44\x12", 28, number, 0, 0x20, len(body), 0, 0, time_status, week, ms, 0, 0, 0
    )
    check = zlib.crc32(header + body, 0xFFFFFFFF) ^ 0xFFFFFFFF
    return header + body + struct.pack("<I", check)


def bestpos(latitude: float = 50.0, status: int = 0, kind: int = 50, age_s: float = 0.5) -> bytes:
    return struct.pack(
        "<IIdddfIfff4sffBBBBBBBB", status, kind, latitude, 8.25, 100.0, 47.0, 61, 0.01, 0.02, 0.03, b"base", age_s, 0.0,
        20, 18, 18, 18, 0, 0, 0, 0,
    )  # fmt: skip


def test_novatels_own_decoder_reads_the_same_from_real_captures(measured_data):
    oem = pytest.importorskip("novatel_edie").oem
    for name in ("bestpos", "ins2", "time"):
        data = (measured_data / "novatel" / f"{name}.gps").read_bytes()
        ours = list(Decoder().take(data))
        parser = oem.Parser()
        parser.write(data)
        names = {log.name for log in ours}
        messages = [message for message in parser if getattr(message, "name", "") in names]
        assert [log.name for log in ours] == [message.name for message in messages]
        for log, message in zip(ours, messages, strict=True):
            assert log.milliseconds == message.header.milliseconds
            compared = {name: getattr(message, theirs) for name, theirs in SAME.items() if name in log.values}
            assert compared
            assert {name: log.values[name] for name in compared} == compared


def test_logs_are_found_among_text_garbage_and_short_pieces():
    frame = log_bytes(42, bestpos())
    stream = b"[ICOM2]#BESTPOSA,ICOM1;\xaa\x44\x12\xaa" + frame + b"<OK\r\n" + frame + frame[:50]
    for size in (1, 7, 64, 1000):
        decoder = Decoder()
        found = [log for at in range(0, len(stream), size) for log in decoder.take(stream[at : at + size])]
        assert [log.name for log in found] == ["BESTPOS", "BESTPOS"]
        assert found[0].values["latitude"] == 50.0
        assert found[0].values["std_up"] == pytest.approx(0.03)
        assert found[0].values["satellites_used"] == 18


def test_no_flipped_bit_passes_and_the_log_behind_is_not_lost():
    frame, rng = log_bytes(42, bestpos()), random.Random(1)
    for _ in range(300):
        damaged = bytearray(frame)
        damaged[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
        good = log_bytes(42, bestpos(latitude=51.0)) * 60  # a claimed length may swallow the next ones
        found = list(Decoder().take(bytes(damaged) + good))
        assert {log.values["latitude"] for log in found} == {51.0}


def test_random_bytes_raise_nothing_and_keep_nothing():
    decoder, rng = Decoder(), random.Random(2)
    for _ in range(500):
        list(decoder.take(rng.choice((b"", b"\xaa\x44\x12\x1c", b"\xaa\x44\x13")) + rng.randbytes(200)))
    assert len(decoder._buffer) < 8192
    assert crc32(b"") == 0


def test_time_is_gps_time_less_leap_seconds():
    (log,) = Decoder().take(log_bytes(42, bestpos(), week=2400, ms=123_456_789))
    # 2026-01-04T00:00:00Z is Unix 1767484800, week 2400 of GPS begins there less 18 s
    clock = GpsClock(ReceiverConfig(address="tcp://x:1"), 0.0)
    assert clock.unix_ns(log.gps_ns) == (1_767_484_800 + 123_456 - 18) * 10**9 + 789_000_000


@pytest.mark.parametrize(
    ("body", "time_status", "quality"),
    [
        (bestpos(), 180, Quality.FIXED),
        (bestpos(kind=56), 160, Quality.FIXED),
        (bestpos(kind=34), 180, Quality.DEGRADED),
        (bestpos(age_s=3.0), 180, Quality.DEGRADED),
        (bestpos(kind=16), 180, Quality.REFUSED),
        (bestpos(status=1), 180, Quality.REFUSED),
        (bestpos(), 100, Quality.REFUSED),
        (bestpos(latitude=float("nan")), 180, Quality.REFUSED),
    ],
)
def test_what_the_receiver_says_of_its_solution_decides(body, time_status, quality):
    (log,) = Decoder().take(log_bytes(42, body, time_status=time_status))
    found, reason = judge(log)
    assert found is quality
    assert bool(reason) == (quality is not Quality.FIXED)


def test_ins_counts_only_when_its_solution_is_good():
    ready = ReceiverLog("INSPVAS", 2400, 0, 180, {"ins_status": 3})
    assert judge(ready)[0] is Quality.FIXED
    for status in (0, 1, 2, 6, 7, 8):
        assert judge(replace(ready, values={"ins_status": status}))[0] is Quality.REFUSED


def test_an_inertial_solution_without_corrections_keeps_its_velocity():
    log = ReceiverLog("INSPVAX", 2400, 0, 180, {"ins_status": 3, "position_type": 53})
    assert judge(log) == (Quality.DEGRADED, "no RTK (type 53)")
    assert judge(replace(log, values=log.values | {"ins_status": 1}))[0] is Quality.REFUSED


def test_nmea_sentences_with_their_signs_units_and_checksums():
    text = (
        b"$GPGGA,123519,4807.038,N,01131.000,W,4,08,0.9,545.4,M,46.9,M,,*50\r\n"
        b"$GPRMC,123519,A,4807.038,S,01131.000,E,022.4,084.4,230394,003.1,W*77\r\n"
        b"$GPHDT,274.07,T*03\r\n$GPHDT,274.08,T*03\r\nrubbish\r\n"
    )
    decoder = NmeaDecoder()
    gga, rmc, hdt = (s for piece in (text[:40], text[40:]) for s in decoder.take(piece))
    assert (gga.latitude, gga.longitude, gga.quality) == (
        pytest.approx(48 + 7.038 / 60), pytest.approx(-(11 + 31 / 60)), 4,
    )  # fmt: skip
    assert (rmc.latitude, rmc.speed, rmc.course) == (
        pytest.approx(-48.1173), pytest.approx(22.4 * 0.514444, rel=1e-5), 84.4,
    )  # fmt: skip
    assert hdt.heading == 274.07
    assert decoder.bad_checksum == 1


def test_check_of_a_receiver_over_tcp():
    server = socket.create_server(("127.0.0.1", 0))
    frames = [log_bytes(42, bestpos(), ms=50 * number) for number in range(21)]

    def serve() -> None:
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"".join(frames))

    threading.Thread(target=serve).start()
    result = CliRunner().invoke(app, ["check", f"tcp://127.0.0.1:{server.getsockname()[1]}", "--json"])
    server.close()
    report = json.loads(result.stdout)
    assert result.exit_code == 0
    assert report["logs"]["BESTPOS"] == {
        "count": 21, "rate_hz": 20.0, "fixed": 21, "degraded": 0, "refused": 0, "reasons": {},
    }  # fmt: skip
