"""Whatever arrives on the wire: no exception, no number that is not finite, nothing outside limits sent."""

from __future__ import annotations

import math
import random

import pytest
from support.cars.scripted_car import Rig
from support.promise_figures import record_figure, volume

from benchmarks.promises.wire_judge import Judge
from can_dbc.codec import load_codec
from hil_gateway.bus.messages import FailsafeAction, VehicleState
from hil_gateway.can_link import Frame


def hostile_frame(rng: random.Random, ids: list[int], stamp_ns: int) -> Frame:
    """Any identifier, any length, any bytes; mostly identifiers and lengths that will be looked into."""
    frame_id = rng.choice(ids) if rng.random() < 0.8 else rng.randrange(1 << 29)
    length = 8 if rng.random() < 0.3 else rng.randrange(9)
    layout = load_codec().by_id.get(frame_id)
    if layout is not None and rng.random() < 0.7:
        length = layout.dlc
    data = rng.choice((rng.randbytes(length), bytes(length), b"\xff" * length))
    return Frame(frame_id, data, stamp_ns + rng.randrange(-(10**9), 10**9), is_error=rng.random() < 0.02)


def numbers(state: VehicleState) -> list[float]:
    return [value for _, value in state if isinstance(value, int | float)]


@pytest.mark.parametrize("driving", [False, True], ids=["from the start", "while driving"])
@pytest.mark.promise("F1")
def test_no_frame_can_upset_the_gateway(driving):
    rng, judge = random.Random(11), Judge()
    rig = Rig()
    if driving:
        rig.drive_off(1.0)
    ids = list(load_codec().by_id)
    count = 0
    target = volume(30_000, 1_000_000)
    while count < target:
        batch = [hostile_frame(rng, ids, rig.now_ns) for _ in range(rng.choice((1, 5, 200)))]
        for frame in batch:
            rig.wire._links[1].queue.append(frame)  # the gateway's end
        count += len(batch)
        rig.step()
        for _, frame in rig.car.heard:
            judge.take(frame.id, frame.data)
        rig.car.heard.clear()
        state = rig.gateway.builder.build(rig.now_ns, 1, 0, 0)
        assert all(map(math.isfinite, numbers(state))), state
    assert not judge.faults
    if driving:
        assert rig.action is not FailsafeAction.DRIVE, "a bus full of nonsense must not be driven on"
    record_figure("F1", f"{count:,} hostile frames through the gateway, 0 exceptions, 0 non-finite values")
