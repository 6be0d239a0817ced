"""A frame with the bytes of the one before is not decoded again, and counts like any other."""

from __future__ import annotations

from collections import Counter
from functools import partial

from can_dbc.codec import Decoder, Fault, Values, load_codec
from hil_gateway.can_link import Frame
from hil_gateway.car.actuation import Actuation
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

MS = 1_000_000
GOOD = bytes.fromhex("c08ac105fac212c8")  # pt_report_1: 6123 rpm in gear 4
BAD = bytes.fromhex("c08affffffffffff")


class Decoded(Counter[int]):
    """Counts how often the frames of an identifier are decoded."""

    def watch(self, build: VehicleStateBuilder) -> None:
        for number, entry in build._received.items():
            entry.decode = partial(self._decode, number, entry.decode)

    def _decode(self, number: int, decode: Decoder, data: bytes) -> Values | Fault:
        self[number] += 1
        return decode(data)


def builder() -> tuple[VehicleStateBuilder, Decoded]:
    config, decoded = Config(), Decoded()
    build = VehicleStateBuilder(config, Actuation(config.vehicle, config.powertrain))
    decoded.watch(build)
    return build, decoded


def test_a_repeated_frame_keeps_its_message_alive_without_being_decoded() -> None:
    build, decoded = builder()
    for k in range(100):
        build.take([Frame(0x53C, GOOD, k * 10 * MS)], k * 10 * MS)
    assert (build.counts.received, decoded.total()) == (100, 1)
    assert build.age_s("powertrain", 99 * 10 * MS) == build.silence_s(99 * 10 * MS) == 0.0
    assert build.build(99 * 10 * MS, 1, 0, 0).sources["powertrain"].valid
    assert build.value("gear") == 4


def test_a_repeated_implausible_frame_is_counted_every_time_and_stays_invalid() -> None:
    build, _ = builder()
    for k in range(10):
        build.take([Frame(0x53C, BAD, k * MS)], k * MS)
    assert build.counts.implausible == 10
    assert not build.build(10 * MS, 1, 0, 0).sources["powertrain"].valid
    build.take([Frame(0x53C, GOOD, 11 * MS)], 11 * MS)
    assert build.build(11 * MS, 1, 0, 0).sources["powertrain"].valid


def test_counters_fixes_and_imu_samples_are_always_decoded() -> None:
    build, decoded = builder()
    for name in ("accelerator_report", "novatel_report", "imu_1"):
        layout = load_codec().messages[name]
        for k in range(5):
            build.take([Frame(layout.id, bytes(layout.dlc), k * MS)], k * MS)
        assert decoded[layout.id] == 5, name
