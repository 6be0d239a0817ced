"""Promise D4: every input has a bound in size, time and memory."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.records import Chunk
from support.cars.scripted_car import Rig
from support.promise_figures import record_figure

from hil_gateway.bus import topics
from hil_gateway.bus.messages import Command, FailsafeAction, OperatorAction, OperatorCommand
from hil_gateway.config import load_config
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.chunk import unpacked
from hil_gateway.track.loading import load_track, shipped_tracks

HEADER = "x_m,y_m,w_tr_right_m,w_tr_left_m"


@pytest.mark.promise("D4")
def test_a_chunk_that_unpacks_to_more_than_it_claims_takes_no_memory() -> None:
    bomb = zstandard.ZstdCompressor(level=3).compress(bytes(1 << 28))
    chunk = Chunk(
        compression="zstd", data=bomb, message_end_time=0, message_start_time=0, uncompressed_crc=0,
        uncompressed_size=1 << 16,
    )  # fmt: skip
    tracemalloc.start()
    with pytest.raises(ValueError, match="another size"):
        unpacked(chunk)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 23
    record_figure("D4", f"a chunk of {len(bomb)} bytes that unpacks to {1 << 28} takes {peak / 1e6:.1f} MB")


def write_track(folder: Path, x: np.ndarray, y: np.ndarray, z: np.ndarray | None = None) -> Path:
    rows = [
        f"{a:.3f},{b:.3f},6,6" + ("" if z is None else f",{c:.3f}")
        for a, b, c in zip(x, y, x if z is None else z, strict=True)
    ]
    path = folder / "track.csv"
    path.write_text("\n".join([HEADER + ("" if z is None else ",z_m"), *rows]))
    return path


@pytest.mark.promise("D4")
def test_a_track_longer_than_any_or_crossing_itself_is_refused_with_the_reason(tmp_path: Path) -> None:
    angle = np.linspace(0, 2 * math.pi, 2000, endpoint=False)
    with pytest.raises(InputError, match=r"m long \(limits"):
        load_track(write_track(tmp_path, 90_000 * np.cos(angle), 90_000 * np.sin(angle)))
    eight = 400 * np.sin(angle), 200 * np.sin(2 * angle)
    with pytest.raises(InputError, match=r"crosses itself near x = -?[0-9]+, y ="):
        load_track(write_track(tmp_path, *eight))
    assert load_track(write_track(tmp_path, *eight, 6 * np.cos(angle))).length > 1000
    for name in shipped_tracks():
        assert load_track(name).length > 1000


@pytest.mark.promise("D4")
def test_a_deep_or_huge_configuration_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "deep.toml"
    path.write_text("a = " + "[" * 100_000)
    with pytest.raises(InputError, match=r"deep\.toml: nested too deeply"):
        load_config(path)


@pytest.mark.promise("D4")
@pytest.mark.parametrize(("field", "value"), [("source", "x" * 65), ("source", "x" * 10**6)])
def test_long_names_are_no_names(field: str, value: str) -> None:
    with pytest.raises(ValueError, match="at most 64"):
        Command.model_validate(
            {"stamp_ns": 0, "seq": 0, "source": "a", "state_stamp_ns": 0, "steer": 0, "drive": 0, field: value}
        )


@pytest.mark.promise("D4")
def test_a_second_delivery_does_not_arm_however_many_others_came_between() -> None:
    rig = Rig()
    rig.run(1.0)
    request = OperatorCommand(stamp_ns=7, seq=7, source="test", action=OperatorAction.ARM)
    rig.bus.publish(topics.OPERATOR, request)
    rig.run(0.3)
    rig.ask(OperatorAction.STOP)
    rig.run(3.0)
    rig.planner_runs = False  # what comes between is refused: only the repeated request could arm
    rig.run(0.3)
    for number in range(200):
        other = request.model_copy(update={"source": f"other{number}"})
        rig.bus.publish(topics.OPERATOR, other)
    rig.run(0.1)
    rig.planner_runs = True
    rig.run(0.3)
    rig.bus.publish(topics.OPERATOR, request)
    rig.run(0.2)
    assert rig.action is FailsafeAction.CONTROLLED_STOP


@pytest.mark.promise("D4")
def test_every_message_has_a_size_above_which_it_is_not_parsed() -> None:
    sizes = {str(topic): topic.max_bytes for topic in topics.TOPICS}
    assert max(sizes.values()) <= 1 << 16
    record_figure("D4", f"{len(sizes)} topics, at most {max(sizes.values())} bytes a message and 1,024 messages a poll")
