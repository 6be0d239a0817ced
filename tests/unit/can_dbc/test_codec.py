"""Codec: known vectors, faults as values, saturation."""

from __future__ import annotations

import math

import pytest

from can_dbc.codec import COUNTER, Codec, Fault, FaultKind, load_codec
from can_dbc.database import BusMessage, Database, Signal
from can_dbc.signals import SignalMap
from can_dbc.units import UNITS

CODEC = load_codec()


def decoded(frame_id: int, text: str) -> dict[str, float]:
    values = CODEC.decode(frame_id, bytes.fromhex(text))
    assert not isinstance(values, Fault)
    return values


def test_pt_report_1_vector() -> None:
    """Big-endian and unaligned: the vector of the public AV-24 description."""
    values = {
        "engine_run_switch": 1, "engine_state": 1, "throttle_position": 55.5, "current_gear": 4,
        "engine_speed_rpm": 6123, "vehicle_speed_kmph": 212.3, "gear_shift_status": 1,
    }  # fmt: skip
    frame_id, data = CODEC.encode_raw("pt_report_1", values)
    assert (frame_id, data.hex()) == (0x53C, "c08ac105fac212c8")
    assert CODEC.decode_raw(frame_id, data) == pytest.approx(values, rel=1e-12)


def test_every_message_is_sent_by_the_car_or_by_the_computer() -> None:
    car, computer = CODEC.sent_by("car"), CODEC.sent_by("computer")
    assert computer == {0x578, 0x579, 0x57A, 0x57B, 0x57C, 0x57D, 0x57E, 0x5AA}
    assert car == set(CODEC.by_id) - computer


def test_decode_gives_si() -> None:
    assert decoded(0x53C, "c08ac105fac212c8") == pytest.approx(
        {
            "engine_run_switch": 1, "engine_state": 1, "throttle_position": 0.555, "current_gear": 4,
            "engine_speed": 6123 * math.tau / 60, "vehicle_speed": 212.3 / 3.6, "gear_shift_status": 1,
        }
    )  # fmt: skip
    assert decoded(0x514, "e803d007b80b0000")["wheel_speed_RL"] == pytest.approx(300 / 3.6)
    assert decoded(0x515, "e803f4010a")["brake_pressure_fdbk_front"] == pytest.approx(1_000_000)
    assert decoded(0x70, "0080000000800000") == pytest.approx(
        {"imu_yaw_rate": 0.0, "imu_ay": (32768 * 0.000127465 - 4.1768) * 9.80665}, abs=1e-12
    )


def test_a_plain_count_stays_an_integer() -> None:
    values = decoded(0x53C, "c08ac105fac212c8")
    assert [type(values[name]) for name in ("engine_state", "current_gear")] == [int, int]
    assert type(values["throttle_position"]) is float


@pytest.mark.parametrize(("start", "frame"), [(4, "402301"), (1, "682400")])
def test_word_sized_fields_off_their_bytes_are_cut_out_of_the_whole_frame(start: int, frame: str) -> None:
    """No message of the car has such a layout: 16 bits that begin within a byte, in steps of 2."""
    field = Signal("speed", start, 16, True, False, 2.0, 0.0, "", None, None, UNITS[""])
    message = BusMessage("odd", 0x100, 3, "ECU", "car", (field,), 0.01, 0.05, None)
    codec = Codec(Database("", 500_000, (message,), ""), SignalMap({}, {}, {}, (), (), (), {}, {}, {}))
    assert codec.encode("odd", {"speed": 0x2468}) == (0x100, bytes.fromhex(frame))
    assert codec.decode(0x100, bytes.fromhex(frame)) == {"speed": 0x2468}


def test_negative_angles_are_sign_extended_from_11_bits() -> None:
    assert decoded(0x520, "ff0700000004")["primary_steering_angle_fbk"] == pytest.approx(math.radians(-0.5))
    assert decoded(0x520, "ff0700000004")["average_steering_ang_fdbk"] == pytest.approx(math.radians(-512))


def test_a_position_is_in_radians() -> None:
    values = decoded(
        0x546, (365844000).to_bytes(4, "little").hex() + (-1217535000).to_bytes(4, "little", signed=True).hex()
    )
    assert values == pytest.approx({"novatel_lat": math.radians(36.5844), "novatel_long": math.radians(-121.7535)})


@pytest.mark.parametrize("frame_id", [0, 0x513, 0x7FF, 0x8000_0514, -1, 1 << 40])
def test_an_unknown_identifier_is_a_fault(frame_id: int) -> None:
    assert CODEC.decode(frame_id, b"12345678") == Fault(FaultKind.UNKNOWN_ID, frame_id, 8)
    assert CODEC.decode_raw(frame_id, b"12345678") == Fault(FaultKind.UNKNOWN_ID, frame_id, 8)
    assert CODEC.decode_quantities(frame_id, b"12345678") == Fault(FaultKind.UNKNOWN_ID, frame_id, 8)


def test_a_wrong_length_is_a_fault_that_says_so() -> None:
    fault = CODEC.decode(0x514, b"1234567")
    assert fault == Fault(FaultKind.WRONG_LENGTH, 0x514, 7, 8)
    assert str(fault) == "0x514: 7 bytes, the DBC says 8"
    assert str(CODEC.decode(0x7FF, b"")) == "0x7FF: identifier not in the DBC"


@pytest.mark.parametrize(
    ("angle_rad", "raw"), [(math.inf, 1023), (-math.inf, -1024), (1e300, 1023), (math.radians(-512.6), -1024), (0.0, 0)]
)
def test_encode_holds_a_value_to_its_field(angle_rad: float, raw: int) -> None:
    zeros = dict.fromkeys(CODEC.messages["steering_cmd"].signal, 0.0)
    frame_id, data = CODEC.encode("steering_cmd", zeros | {"steering_motor_ang_cmd": angle_rad})
    back = CODEC.decode_raw(frame_id, data)
    assert not isinstance(back, Fault)
    assert back["steering_motor_ang_cmd"] == raw * 0.5
    assert all(value == 0 for name, value in back.items() if name != "steering_motor_ang_cmd")


def test_a_bug_in_the_caller_is_an_exception() -> None:
    with pytest.raises(ValueError, match="NaN"):
        CODEC.encode("gear_shift_cmd", {"desired_gear": math.nan})
    with pytest.raises(KeyError, match="desired_gear"):
        CODEC.encode("gear_shift_cmd", {})
    with pytest.raises(KeyError, match="desired_gear"):
        CODEC.encode("gear_shift_cmd", {"gear": 1})
    with pytest.raises(ValueError, match="gear_shift_cmd has no signal gear"):
        CODEC.encode("gear_shift_cmd", {"desired_gear": 1, "gear": 1})
    with pytest.raises(KeyError, match="gear_cmd"):
        CODEC.encode("gear_cmd", {"desired_gear": 1})


def test_quantities_are_the_signals_they_stand_for() -> None:
    """Names and signs of `signals.toml` on the frames of the other tests."""
    powertrain = CODEC.decode_quantities(0x53C, bytes.fromhex("c08ac105fac212c8"))
    assert not isinstance(powertrain, Fault)
    assert (powertrain["gear"], powertrain["engine_on"]) == (4, 1)
    assert powertrain["engine_speed"] == pytest.approx(6123 * math.pi / 30)
    assert powertrain["speed"] == pytest.approx(212.3 / 3.6)
    assert CODEC.encode_quantities("pt_report_1", powertrain) == (0x53C, bytes.fromhex("c08ac105fac212c8"))


def test_a_message_says_its_quantities_without_its_counter() -> None:
    assert CODEC.quantities("accelerator_report") == ("accelerator",)


def test_what_no_quantity_sets_is_at_rest() -> None:
    _, data = CODEC.encode_quantities("pt_report_4", {})
    values = CODEC.decode_raw(0x540, data)
    assert not isinstance(values, Fault)
    assert values["intake_manifold_press_kPa"] == pytest.approx(100.0)
    assert values["boost_press_psi"] == 0.0


def test_a_rolling_counter_has_one_name_in_every_message() -> None:
    counted = [m for m in CODEC.messages.values() if m.counter is not None]
    for message in counted:
        _, data = CODEC.encode_raw(message.name, {s.name: 3 for s in message.signals})
        values = CODEC.decode_quantities(message.id, data)
        assert not isinstance(values, Fault)
        assert values[COUNTER] == 3
