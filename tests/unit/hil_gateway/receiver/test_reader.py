"""Bytes of a receiver to messages: units, axes and times; what is refused, and why; streams that break."""

from __future__ import annotations

import math
import random
import socket
import struct
import time
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.outside import Navigation, Quality
from hil_gateway.car.car import Receiver
from hil_gateway.config import load_config
from hil_gateway.receiver.core import Receivers
from hil_gateway.receiver.node import SILENT_NS, Connection
from hil_gateway.receiver.oem7 import LOGS, SHORT_LOGS, Decoder, ReceiverLog, encode
from hil_gateway.receiver.reader import MOST_A_SECOND, Reader
from hil_gateway.settings.receivers import ReceiverConfig

S = 10**9
UNIX_NS = 1_767_484_800 * S
"""2026-01-04T00:00:00Z, where GPS week 2400 begins 18 s earlier"""
DECLARED = Receiver(x=0.0, y=0.0, noise=0.02, wander=0.0, wander_time=600.0, delay=0.03, yaw=math.radians(10.0))
GOOD = {"latitude": 36.0, "longitude": -121.0, "height_msl": 100.0, "undulation": -30.0, "datum": 61,
        "std_north": 0.01, "std_east": 0.02, "std_up": 0.03, "differential_age_s": 1.0}  # fmt: skip
NAMES = {
    "height_msl": "orthometric_height", "std_north": "latitude_std_dev", "std_east": "longitude_std_dev",
    "std_up": "height_std_dev", "differential_age_s": "diff_age", "solution_age_s": "solution_age",
    "satellites": "num_svs", "satellites_used": "num_soln_svs", "speed": "horizontal_speed", "track": "ground_track",
    "up": "z", "latency_s": "latency", "baseline": "b_length", "heading_std": "heading_std_dev",
    "pitch_std": "pitch_std_dev", "north": "north_vel", "east": "east_vel",
    "std_speed_north": "north_vel_std_dev", "std_speed_east": "east_vel_std_dev", "std_speed_up": "up_vel_std_dev",
    "std_roll": "roll_std_dev", "std_pitch": "pitch_std_dev", "std_azimuth": "azimuth_std_dev",
    "samples": "accum_count",
}  # fmt: skip
"""our name of a field -> NovAtel's, where they differ"""
UP_OF_INS = {"INSPVAX": {"up": "up_vel"}}


def a_reader(clock: str = "gps") -> Reader:
    return Reader("top", ReceiverConfig(address="tcp://127.0.0.1:1", clock=clock), DECLARED)  # type: ignore[arg-type]


def log(name: str, ms: int, **values: float) -> bytes:
    return encode(ReceiverLog(name, 2400, ms, 180, values))


def bestpos(ms: int, kind: int = 50, **values: float) -> bytes:
    return log("BESTPOS", ms, position_type=kind, **{**GOOD, **values})


def take(reader: Reader, data: bytes, gps_ms: int, late_ms: int = 40) -> list[Navigation]:
    """As it arrives that much after its GPS time, on a computer that was started as GPS week 2400 began."""
    return reader.take(data, (gps_ms + late_ms) * 1_000_000, UNIX_NS - 18 * S)


@pytest.mark.parametrize("name", ["BESTPOS", "BESTVEL", "HEADING2", "INSPVAX", "CORRIMUS"])
def test_novatels_own_decoder_reads_what_we_encode(name):
    oem = pytest.importorskip("novatel_edie").oem
    layout = next(layout for layout in LOGS.values() if layout.name == name)
    rng = random.Random(name)
    values = {field: rng.uniform(0.5, 40.0) for field in layout.fields}
    values |= {f: 0 for f in ("solution_status", "position_type", "velocity_type", "ins_status") if f in values}
    counts = "satellites", "satellites_used", "samples", "extended", "age_s"
    values |= {field: rng.randrange(40) for field in counts if field in values}
    values |= {"datum": 61} if "datum" in values else {}
    parser = oem.Parser()
    parser.write(encode(ReceiverLog(name, 2400, 123_456, 180, values)))
    (message,) = parser
    assert (message.name, message.header.week, message.header.milliseconds) == (name, 2400, 123_456)
    found = dict(zip(("pitch", "roll", "yaw"), message.corr_wb_ib, strict=True)) if name == "CORRIMUS" else {}
    found |= dict(zip(("lateral", "longitudinal", "vertical"), message.corr_fb, strict=True)) if found else {}
    renamed = {**NAMES, **UP_OF_INS.get(name, {})}
    compared = [f for f in values if f in found or hasattr(message, renamed.get(f, f))]
    assert len(compared) >= len(values) - 3
    for field in compared:
        theirs = found.get(field, getattr(message, renamed.get(field, field), None))
        assert getattr(theirs, "value", theirs) == pytest.approx(values[field], rel=1e-6), field


@pytest.mark.parametrize("name", ["BESTPOS", "INSPVAX"])
def test_we_decode_what_novatels_own_encoder_makes(name):
    oem = pytest.importorskip("novatel_edie").oem
    message = getattr(oem.messages, name)()
    message.latitude, message.longitude, message.undulation = 36.5, -121.75, -30.5
    message.latitude_std_dev, message.header.week, message.header.milliseconds = 0.25, 2400, 5
    (found,) = Decoder().take(bytes(message.to_binary().message))
    assert (found.name, found.week, found.milliseconds) == (name, 2400, 5)
    picked = [found.values[key] for key in ("latitude", "longitude", "undulation", "std_north")]
    assert picked == [36.5, -121.75, -30.5, 0.25]


def test_position_has_its_own_deviations_and_the_time_that_it_is_of():
    (message,) = take(a_reader(), bestpos(50_000), 50_000, late_ms=40)
    assert (message.quality, message.places, message.log) == (Quality.FIXED, True, "BESTPOS")
    assert message.stamp_ns == 50_000 * 1_000_000
    assert message.late_s == pytest.approx(0.04)
    assert message.place is not None
    assert (message.place.height, message.place.std_east) == (70.0, pytest.approx(0.02))


def test_azimuths_are_yaws_from_east_to_the_left():
    reader = a_reader()
    (ins,) = take(reader, log("INSPVAX", 1000, ins_status=3, position_type=56, azimuth=90.0, east=20.0, north=1.0,
                              std_azimuth=0.1), 1000)  # fmt: skip
    assert ins.heading is not None
    assert ins.velocity is not None
    assert ins.heading.yaw == pytest.approx(0.0, abs=1e-12)
    assert ins.heading.std == pytest.approx(math.radians(0.1))
    assert (ins.velocity.east, ins.velocity.north) == (20.0, 1.0)
    (antennas,) = take(reader, log("HEADING2", 1000, position_type=50, heading=0.0, heading_std=0.5), 1000)
    assert antennas.heading is not None  # the line of the antennas is 10 deg to the left of where the car points
    assert antennas.heading.yaw == pytest.approx(math.radians(90.0 - 10.0))
    (velocity,) = take(reader, log("BESTVEL", 1000, velocity_type=50, speed=10.0, track=180.0, latency_s=0.02), 1000)
    assert velocity.velocity is not None
    assert velocity.velocity.north == pytest.approx(-10.0)
    assert ins.stamp_ns - velocity.stamp_ns == 20_000_000


def test_increments_are_rates_in_the_cars_axes():
    reader = a_reader()
    assert take(reader, log("TIME", 980) + log("CORRIMUS", 1000, yaw=1.0), 1000) == []
    (message,) = take(reader, log("CORRIMUS", 1010, yaw=0.002, lateral=0.05, longitudinal=0.01, vertical=0.098), 1010)
    assert message.rates is not None
    rates = message.rates
    assert (rates.yaw_rate, rates.ax, rates.ay, rates.az) == pytest.approx((0.2, 1.0, -5.0, 9.8))


@pytest.mark.parametrize("clock", ["gps", "arrival"])
def test_what_is_later_than_the_others_has_the_time_that_it_is_of(clock):
    """On a computer whose clock is a day off where arrival decides: 0.03 s are declared of the fastest."""
    reader, least_ms = a_reader(clock), 80 if clock == "gps" else 30
    stamps = []
    for number in range(40):
        late_ms = least_ms + (number * 7) % 20
        arrived_ns = (50 * number + late_ms) * 1_000_000 + S
        offset_ns = UNIX_NS - 18 * S - S if clock == "gps" else 0
        (message,) = reader.take(bestpos(50 * number, longitude=-121 + 1e-7 * number), arrived_ns, offset_ns)
        assert message.quality is Quality.FIXED
        stamps.append(message.stamp_ns - 50 * number * 1_000_000 - S)
    assert stamps == [0] * 40


def test_leap_seconds_are_the_receivers_own_where_it_says_them():
    reader = a_reader()
    take(reader, log("TIME", 900, utc_offset_s=-19.0), 1000)
    (message,) = take(reader, bestpos(1000), 1000)
    assert message.quality is Quality.REFUSED  # this computer's clock would be 1 s behind
    assert "clock" in message.reason
    assert reader.health(0).leap_s == 19


def test_a_clock_that_does_not_keep_gps_time_is_named_and_nothing_is_believed():
    for late_ms in (-60, 700):
        (message,) = take(a_reader(), bestpos(100_000), 100_000, late_ms)
        assert message.quality is Quality.REFUSED
        assert "ahead of GPS time" in message.reason
        assert message.place is None


def moving(reader: Reader, number: int, east_m: float, step_m: float = 2.0) -> Navigation:
    """The `number`th position of a car that goes east with 40 m/s, `east_m` beside its way."""
    ms, radius = 10_000 + 50 * number, 6_378_137.0 * math.cos(math.radians(36.0))
    longitude = -121.0 + math.degrees((step_m * number + east_m) / radius)
    velocity = log("BESTVEL", ms, velocity_type=50, speed=40.0, track=90.0)
    *_, found = take(reader, velocity + bestpos(ms, longitude=longitude), ms)
    return found


def test_jump_repeat_and_hang_are_refused_by_name():
    reader = a_reader()
    assert all(moving(reader, number, 0.01 * (-1) ** number).quality is Quality.FIXED for number in range(5))
    assert moving(reader, 5, 8.0).reason == "jumps"
    assert moving(reader, 6, 8.0).quality is Quality.FIXED  # from where it has led: others judge that
    assert moving(reader, 6, 8.0).reason == "repeated"
    assert moving(reader, 7, 6.0).reason == "hangs"  # 2 m less of the offset: the very same place again
    refused = reader.health(0).refused
    assert (refused["jumps"], refused["hangs"]) == (1, 1)
    assert refused["repeated"] == 2  # the velocity of that time too


def test_cause_says_why_the_car_is_not_placed():
    reader = a_reader()
    assert reader.cause(0) == "not connected yet"
    reader.begin()
    assert reader.cause(0) == "no position has come"
    now = 50 * S
    take(reader, bestpos(50_000), 50_000, 0)
    assert reader.cause(now) == ""
    for number in range(20):
        ms = 50_050 + 50 * number
        take(reader, bestpos(ms, kind=16), ms, 0)
    assert reader.cause(now + S) == "no RTK (type 16)"
    reader.broken = "it has ended the connection"
    assert reader.cause(now + S) == "it has ended the connection"


def test_positions_of_the_inertial_solution_place_the_car_where_there_are_no_others_and_at_20_hz():
    reader = a_reader()

    def ins(ms):
        place = {"latitude": 36.0, "longitude": -121 + 1e-9 * ms, "std_north": 0.02}
        return log("INSPVAX", ms, ins_status=3, position_type=56, **place)

    alone = [take(reader, ins(10_000 + 10 * n), 10_000 + 10 * n)[0].places for n in range(20)]
    assert alone.count(True) == 4
    times = [20_000 + 50 * n for n in range(20)]
    both = [message.places for ms in times for message in take(reader, bestpos(ms) + ins(ms), ms)]
    assert both == [True, False] * 20


def test_nmea_is_enough_to_place_the_car():
    def sentence(text: str) -> bytes:
        checksum = 0
        for byte in text.encode():
            checksum ^= byte
        return f"${text}*{checksum:02X}\r\n".encode()

    reader, unix_ns = a_reader(), UNIX_NS + 3600 * S
    lines = sentence("GPGGA,010000.00,3635.0,N,12145.0,W,4,12,0.7,50.0,M,-30.0,M,1.0,0") + sentence(
        "GPRMC,010000.00,A,3635.0,N,12145.0,W,20.0,90.0,040126,,"
    ) + sentence("GPHDT,100.0,T")  # fmt: skip
    place, velocity, heading = reader.take(lines, 3600 * S + 30_000_000, UNIX_NS)
    assert (place.places, place.quality, place.stamp_ns) == (True, Quality.FIXED, unix_ns - UNIX_NS)
    assert velocity.velocity is not None
    assert velocity.velocity.east == pytest.approx(20.0 * 1852 / 3600)
    assert heading.heading is not None
    assert heading.heading.yaw == pytest.approx(math.radians(90.0 - 100.0 - 10.0))
    (float_rtk,) = reader.take(
        sentence("GPGGA,235959.95,3635.0,N,12145.0,W,5,12,0.7,,M,,M,,"), 86_400 * S, UNIX_NS
    )  # fmt: skip
    assert (float_rtk.quality, float_rtk.stamp_ns) == (Quality.DEGRADED, 86_400 * S - 50_000_000)


def test_reasons_are_counted_by_name_only_so_far():
    reader = a_reader()
    for kind in range(100, 300):
        take(reader, bestpos(10_000 + kind, kind=kind), 10_000 + kind)
    refused = reader.health(0).refused
    assert len(refused) < 64
    assert sum(refused.values()) == 200


def test_a_flood_is_cut_off_and_counted():
    reader, data = a_reader(), b"".join(bestpos(10_000 + n) for n in range(3000))
    assert len(take(reader, data, 10_000)) == MOST_A_SECOND
    assert reader.health(0).refused[f"more than {MOST_A_SECOND} a second"] == 2000


@settings(max_examples=150)
@given(
    st.sampled_from(sorted(LOGS)), st.binary(min_size=130, max_size=130), st.integers(0, 2**16 - 1),
    st.integers(0, 2**32 - 1), st.booleans(),
)  # fmt: skip
def test_no_body_with_a_right_checksum_raises_or_says_what_is_not_finite(number, body, week, ms, good):
    layout, reader = LOGS[number], a_reader("arrival")
    statuses = struct.pack("<II", 3 if layout.name == "INSPVAX" else 0, 56) if good else b""
    body = (statuses + body)[: layout.struct.size]
    if layout.name in SHORT_LOGS:
        frame = struct.pack("<3sBHHI", b"\xaa\x44\x13", len(body), number, week, ms) + body
    else:
        head = b"\xaa\x44\x12", 28, number, 0, 32, len(body), 0, 0, 180, week, ms, 0, 0, 0
        frame = struct.pack("<3sBHBBHHBBHIIHH", *head) + body
    frame += struct.pack("<I", zlib.crc32(frame, 0xFFFFFFFF) ^ 0xFFFFFFFF)
    for message in reader.take(frame, S, 0):
        assert Navigation.model_validate_json(message.model_dump_json()) == message
    reader.health(S)


@settings(max_examples=100)
@given(
    st.lists(
        st.binary(max_size=60) | st.sampled_from((b"$GPGGA,", b"$GPRMC,", b"$GPHDT,", b"*00\r\n", b",,,")), max_size=12
    )
)
def test_no_text_raises(pieces):
    reader = a_reader()
    for piece in pieces:
        reader.take(piece, S, UNIX_NS)


def test_a_stream_that_ends_is_opened_again_and_says_so():
    server = socket.create_server(("127.0.0.1", 0))
    address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
    reader = a_reader()
    connection = Connection(ReceiverConfig(address=address), reader)
    for _ in range(2):
        connection.open(time.monotonic_ns())
        with server.accept()[0] as accepted:
            accepted.sendall(bestpos(1000))
        data = b""
        while connection.stream is not None:
            data += connection.read(time.monotonic_ns())
        assert data == bestpos(1000)
        assert reader.broken == f"{address} has ended the connection"
        connection._next_ns = 0
    assert reader.connections == 2
    connection.open(S)
    connection.open(S + SILENT_NS + 1)
    assert "no byte" in reader.broken
    server.close()
    connection.open(100 * S)
    while connection.stream is not None:
        connection.read(100 * S)
    assert "refused" in reader.broken.lower()


def test_status_follows_a_cause_at_once_and_else_every_second():
    config = load_config(None, {"receivers": {"novatel_top": {"address": "tcp://127.0.0.1:1", "clock": "gps"}}})
    bus = LocalBus()
    statuses, receivers = bus.subscribe(topics.RECEIVER_STATUS, 100), Receivers(config, bus)
    receivers.readers["novatel_top"].begin()
    for tick in range(300):
        now = 50 * S + tick * 10_000_000
        if tick == 105:
            receivers.take({"novatel_top": bestpos(50_000 + 10 * tick)}, now, UNIX_NS - 18 * S)
        receivers.step(now)
    found = [(s.stamp_ns // 10_000_000 - 5000, s.receivers["novatel_top"].cause) for s in statuses.poll(0)]
    assert [tick for tick, _ in found] == [0, 100, 110, 156, 256]
    stale = ["no position comes any more"] * 2
    assert [cause for _, cause in found] == ["no position has come"] * 2 + [""] + stale
