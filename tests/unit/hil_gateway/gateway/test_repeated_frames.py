"""A frame with the bytes of the one before is not decoded again, and counts like any other."""

from __future__ import annotations

from can_dbc.codec import Codec, load_codec
from hil_gateway.can_link import Frame
from hil_gateway.car.actuation import Actuation
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

MS = 1_000_000
GOOD = bytes.fromhex("c08ac105fac212c8")  # pt_report_1: 6123 rpm in gear 4
BAD = bytes.fromhex("c08affffffffffff")


class Counting(Codec):
    """Counts how often a frame is decoded."""

    decoded = 0

    def decode(self, frame_id, data):
        self.decoded += 1
        return super().decode(frame_id, data)


def builder() -> tuple[VehicleStateBuilder, Counting]:
    config = Config()
    codec = Counting.__new__(Counting)
    codec.__dict__.update(load_codec().__dict__)
    return VehicleStateBuilder(config, codec, Actuation(config.vehicle, config.powertrain)), codec


def test_a_repeated_frame_keeps_its_message_alive_without_being_decoded() -> None:
    build, codec = builder()
    for k in range(100):
        build.take([Frame(0x53C, GOOD, k * 10 * MS)], k * 10 * MS)
    assert (build.counts.received, codec.decoded) == (100, 1)
    assert build.age_s("pt_report_1", 99 * 10 * MS) == build.silence_s(99 * 10 * MS) == 0.0
    assert build.build(99 * 10 * MS, 1, 0, 0).sources["powertrain"].valid
    assert build.signal("current_gear") == 4


def test_a_repeated_implausible_frame_is_counted_every_time_and_stays_invalid() -> None:
    build, _ = builder()
    for k in range(10):
        build.take([Frame(0x53C, BAD, k * MS)], k * MS)
    assert build.counts.implausible == 10
    assert not build.build(10 * MS, 1, 0, 0).sources["powertrain"].valid
    build.take([Frame(0x53C, GOOD, 11 * MS)], 11 * MS)
    assert build.build(11 * MS, 1, 0, 0).sources["powertrain"].valid


def test_counters_fixes_and_imu_samples_are_always_decoded() -> None:
    build, codec = builder()
    for name in ("accelerator_report", "novatel_report", "imu_1"):
        layout, before = codec.messages[name], codec.decoded
        for k in range(5):
            build.take([Frame(layout.id, bytes(layout.dlc), k * MS)], k * MS)
        assert codec.decoded - before == 5, name
