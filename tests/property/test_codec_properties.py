"""Promises F1 and F2 for the codec, against cantools as the independent decoder."""

from __future__ import annotations

import math
import random

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.promise_figures import record_figure, volume

from can_dbc.codec import Fault, load_codec
from can_dbc.database import BusMessage
from can_dbc.folder import SHIPPED

CODEC = load_codec()
PEER = cantools.database.load_file(SHIPPED / "av24/av24.dbc")
FUZZ_FRAMES = volume(100_000, 1_000_000)
EXAMPLES = volume(20, 40)
"""of every message"""


def raw_values(message: BusMessage) -> st.SearchStrategy[dict[str, int]]:
    """Any raw integers the fields of a message can hold."""
    return st.fixed_dictionaries({s.name: st.integers(*s.raw_range) for s in message.signals})


def physical(message: BusMessage, raws: dict[str, int]) -> dict[str, float]:
    return {s.name: raws[s.name] * s.scale + s.offset for s in message.signals}


@pytest.mark.promise("F2")
@pytest.mark.parametrize("name", CODEC.messages)
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
@given(data=st.data())
def test_encode_and_decode_agree_with_cantools_over_the_whole_raw_range(name: str, data: st.DataObject) -> None:
    message, peer = CODEC.messages[name], PEER.get_message_by_name(name)
    values = physical(message, data.draw(raw_values(message)))
    frame_id, frame = CODEC.encode_raw(name, values)
    assert frame_id == peer.frame_id
    assert frame == peer.encode(values, strict=False)
    assert CODEC.decode_raw(frame_id, frame) == peer.decode(frame, decode_choices=False)


@pytest.mark.promise("F2")
def test_the_ends_of_every_signal_of_every_message_agree_with_cantools() -> None:
    for name, message in CODEC.messages.items():
        for end in (0, 1):
            values = physical(message, {s.name: s.raw_range[end] for s in message.signals})
            frame_id, frame = CODEC.encode_raw(name, values)
            assert frame == PEER.get_message_by_name(name).encode(values, strict=False)
            assert CODEC.decode_raw(frame_id, frame) == PEER.decode_message(frame_id, frame, decode_choices=False)
    signals = sum(len(message.signals) for message in CODEC.messages.values())
    record_figure("F2", f"{len(CODEC.messages)} messages, {signals} signals agree with cantools, ends and random")


@pytest.mark.promise("F2")
@pytest.mark.parametrize("name", CODEC.messages)
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
@given(data=st.data())
def test_packed_integers_are_the_integers_on_the_wire(name: str, data: st.DataObject) -> None:
    message = CODEC.messages[name]
    raws = data.draw(raw_values(message))
    frame_id, frame = CODEC.pack(name, raws)
    read = PEER.decode_message(frame_id, frame, decode_choices=False, scaling=False)
    assert read == raws


@pytest.mark.promise("F2")
def test_an_integer_beyond_its_field_is_held_to_it_and_nothing_but_integers_is_packed() -> None:
    for raw, held in ((1 << 40, 255), (-1, 0)):
        assert CODEC.pack("gear_shift_cmd", {"desired_gear": raw}) == CODEC.pack(
            "gear_shift_cmd", {"desired_gear": held}
        )
    with pytest.raises((TypeError, AttributeError)):
        CODEC.pack("gear_shift_cmd", {"desired_gear": 1.0})  # type: ignore[dict-item]
    with pytest.raises(KeyError):
        CODEC.pack("gear_shift_cmd", {})
    with pytest.raises(ValueError, match="gear_shift_cmd has no signal gear"):
        CODEC.pack("gear_shift_cmd", {"desired_gear": 1, "gear": 1})
    fields = {signal.name: 1 for signal in CODEC.messages["pt_report_2"].signals}
    with pytest.raises(ValueError, match=r"pt_report_2 has no signal fuel_pressure$"):
        CODEC.pack("pt_report_2", fields | {"fuel_pressure": 1})


@pytest.mark.promise("F2")
@pytest.mark.parametrize("name", CODEC.messages)
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
@given(data=st.data())
def test_decode_and_encode_are_inverse_in_si(name: str, data: st.DataObject) -> None:
    message = CODEC.messages[name]
    frame_id, frame = CODEC.encode_raw(name, physical(message, data.draw(raw_values(message))))
    values = CODEC.decode(frame_id, frame)
    assert not isinstance(values, Fault)
    assert CODEC.encode(name, values) == (frame_id, frame)


@pytest.mark.promise("F2")
@pytest.mark.parametrize("name", CODEC.messages)
def test_si_is_the_dbc_value_times_its_unit(name: str) -> None:
    message, rng = CODEC.messages[name], random.Random(name)
    for _ in range(20):
        raw, si = (f(message.id, b) for b in [rng.randbytes(message.dlc)] for f in (CODEC.decode_raw, CODEC.decode))
        assert not isinstance(raw, Fault)
        assert si == pytest.approx(
            {s.si_name: raw[s.name] * s.si_factor for s in message.signals}, rel=1e-12, abs=1e-12
        )


@pytest.mark.promise("F2")
@pytest.mark.parametrize("name", CODEC.messages)
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
@given(data=st.data())
def test_any_number_is_encoded_within_half_a_step_or_at_the_end_of_the_field(name: str, data: st.DataObject) -> None:
    message = CODEC.messages[name]
    numbers = st.floats(allow_nan=False, width=64)
    values = {s.si_name: data.draw(numbers) for s in message.signals}
    back = CODEC.decode(*CODEC.encode(name, values))
    assert not isinstance(back, Fault)
    for signal in message.signals:
        ends = sorted((raw * signal.scale + signal.offset) * signal.si_factor for raw in signal.raw_range)
        held = min(max(values[signal.si_name], ends[0]), ends[1])
        assert back[signal.si_name] == pytest.approx(held, abs=0.5 * signal.si_resolution * (1 + 1e-9), rel=1e-9)


@pytest.mark.promise("F1")
def test_any_identifier_length_and_bytes_give_values_or_a_fault() -> None:
    rng = random.Random(20240501)
    known = list(CODEC.by_id)
    faults = 0
    for _ in range(FUZZ_FRAMES):
        frame_id = rng.choice(known) if rng.random() < 0.7 else rng.getrandbits(11)
        length = CODEC.by_id[frame_id].dlc if frame_id in CODEC.by_id and rng.random() < 0.7 else rng.randint(0, 8)
        values = CODEC.decode(frame_id, rng.randbytes(length))
        if isinstance(values, Fault):
            faults += 1
        else:
            assert all(map(math.isfinite, values.values()))
            assert length == CODEC.by_id[frame_id].dlc
    assert 0 < faults < FUZZ_FRAMES


@pytest.mark.promise("F1")
def test_only_declared_identifiers_and_lengths_are_decoded() -> None:
    """All 2,048 identifiers with every length."""
    accepted = {
        (frame_id, length)
        for frame_id in range(2048)
        for length in range(9)
        if not isinstance(CODEC.decode(frame_id, bytes(length)), Fault)
    }
    assert accepted == {(message.id, message.dlc) for message in CODEC.messages.values()}
