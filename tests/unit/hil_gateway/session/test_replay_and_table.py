"""Sessions are played back in order and at the speed asked for, never command a car, and become drive logs."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from support.examples import run_example

from hil_gateway.bus import messages as m
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import COMMAND, ESTIMATE, OPERATOR, PLAN, TRUTH, VEHICLE_STATE
from hil_gateway.can_link import Frame, VirtualWire
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.car import load_car
from hil_gateway.process.clock import VirtualClock
from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import FROM_ESTIMATE, FROM_STATE, read_drive_table
from hil_gateway.session.exchange.export import export_csv, export_parquet
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.files.writer import SessionWriter
from hil_gateway.session.playback.replay import DEFAULT_TOPICS, in_order, replay, to_bus, to_can

STEP_NS = 10_000_000


def vehicle_state(number: int) -> m.VehicleState:
    return m.VehicleState(
        stamp_ns=number * STEP_NS, seq=number, valid=True, sources={}, ax=0.1 * number, ay=1, az=9.8, yaw_rate=0.2,
        roll_rate=0, wheel_speed_fl=10, wheel_speed_fr=10, wheel_speed_rl=11, wheel_speed_rr=11, steer=0.05,
        steer_rate=0, accelerator=0.3, throttle=0.4, brake_front=2e5, brake_rear=1e5, drive=0.02, gear=3,
        engine_speed=400, position_x=0, position_y=0, position_seq=number, sys_state=9, ct_state=9, track_flag=1,
        vehicle_flag=0,
    )  # fmt: skip


def estimate(number: int, valid: bool = True) -> m.Estimate:
    stamp_ns = number * STEP_NS
    return m.Estimate(
        stamp_ns=stamp_ns + 10, seq=number, state_stamp_ns=stamp_ns, valid=valid, x=number, y=2, yaw=0.3,
        vx=20 + number, vy=0.1, yaw_rate=0.21, bias_ax=0.5, bias_ay=0, bias_yaw_rate=0, std=(0.0,) * 9, steer=0.05,
        drive=0.02, innovations_rejected=0,
    )  # fmt: skip


def plan(number: int, lap: int) -> m.Plan:
    one = (0.0,)
    return m.Plan(
        stamp_ns=number * STEP_NS, seq=number, state_stamp_ns=number * STEP_NS, status=m.PlanStatus.SOLVED, dt=0.05,
        x=one, y=one, yaw=one, vx=one, s=one, steer=one, drive=one, lap=lap, revision="r", solve_ms=1,
    )  # fmt: skip


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """100 states and estimates (the first ten not valid, one state missing), two laps, and the plant's truth."""
    path = tmp_path / "s.mcap"
    writer = SessionWriter(path, {}, 10**9)
    for number in range(100):
        at_ns = number * STEP_NS
        if number != 50:
            writer.add(VEHICLE_STATE.key, vehicle_state(number).model_dump_json().encode(), at_ns, at_ns, number)
        answer = estimate(number, valid=number >= 10).model_dump_json().encode()
        writer.add(ESTIMATE.key, answer, at_ns + 5, at_ns + 10, number)
        if number in (0, 60):
            message = plan(number, lap=1 if number else 0).model_dump_json().encode()
            writer.add(PLAN.key, message, at_ns + 6, at_ns, number)
        frame = Frame(0x514, bytes(8), at_ns)
        writer.add(CAN_TOPIC, pack_frame(frame, at_ns), at_ns + 7, at_ns, number)
    writer.close(0)
    return path


def test_drive_table_joins_every_valid_estimate_with_the_state_it_answers(session: Path) -> None:
    table = read_drive_table(session)
    columns = table.columns
    assert len(columns["t"]) == 89
    assert table.left_out == {"estimate not valid": 10, "vehicle state missing": 1}
    assert table.start_ns == 10 * STEP_NS
    np.testing.assert_allclose(columns["t"][:3], [0.0, 0.01, 0.02])
    np.testing.assert_allclose(columns["vx"][:2], [30.0, 31.0])
    np.testing.assert_allclose(columns["ax"][:2], [1.0, 1.1], err_msg="as measured: nothing is taken off")
    np.testing.assert_allclose(columns["brake"], 1.5e5)
    assert columns["lap"].tolist() == [0.0] * 49 + [1.0] * 40


def test_drive_table_has_the_columns_of_the_format_and_nothing_of_the_truth(session: Path) -> None:
    assert set(read_drive_table(session).columns) == {
        "t", "vx", "vy", "yaw_rate", "ax", "ay", "az", "steer", "drive", "x", "y", "yaw", "lap", "throttle", "brake",
        "brake_balance", "wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr", "gear",
        "engine_speed", "vy_std",
    }  # fmt: skip
    assert not set(FROM_ESTIMATE) & set(FROM_STATE)


def test_the_example_prints_what_a_session_holds(
    session: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_example("read_session", [str(session)], monkeypatch)
    said = capsys.readouterr().out
    assert "brake    150000.000 to 150000.000" in said
    assert "lap 0: 30.0 to 79.0 m/s" in said and "lap 1: 80.0 to 119.0 m/s" in said
    assert "10 rows left out: estimate not valid" in said


def test_exports_hold_the_same_numbers_to_the_last_digit(session: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    columns = read_drive_table(session).columns
    for done in (export_csv(session, tmp_path / "s.csv"), export_parquet(session, tmp_path / "s.parquet")):
        assert (done.rows, done.left_out) == (89, {"estimate not valid": 10, "vehicle state missing": 1})
    with (tmp_path / "s.csv").open() as file:
        rows = list(csv.DictReader(file))
    parquet = pq.read_table(tmp_path / "s.parquet").to_pydict()
    for name, values in columns.items():
        assert [float(row[name]) for row in rows] == values.tolist() == parquet[name]


def test_session_without_estimates_gets_one_clear_line(tmp_path: Path) -> None:
    SessionWriter(tmp_path / "empty.mcap", {}, 10**9).close(0)
    with pytest.raises(InputError, match="holds no valid av24/estimate"):
        read_drive_table(tmp_path / "empty.mcap")


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_replay_keeps_the_recorded_spacing_at_any_speed(session: Path, speed: float) -> None:
    clock = VirtualClock(start_ns=777)
    times: list[tuple[int, int]] = []
    items = in_order(SessionReader(session).items())
    count = replay(items, lambda item: times.append((item.publish_ns, clock.now_ns())), clock, speed)
    assert count == len(times) == 301
    first_ns = times[0][0]
    assert all(at_ns == 777 + int((publish_ns - first_ns) / speed) for publish_ns, at_ns in times)


def test_replay_as_fast_as_possible_never_waits(session: Path) -> None:
    clock = VirtualClock()
    replay(in_order(SessionReader(session).items()), lambda item: None, clock, speed=0)
    assert clock.now_ns() == 0


def test_items_come_out_by_time_of_publication() -> None:
    items = [Item("a", 1000 + i, published, i, b"") for i, published in enumerate((5, 3, 9, 3, 1))]
    assert [(i.publish_ns, i.sequence) for i in in_order(items)] == [(1, 4), (3, 1), (3, 3), (5, 0), (9, 2)]


def test_a_recorder_that_was_held_up_and_a_clock_that_was_set_back_are_played_without_haste() -> None:
    """What came late is given out at once; what follows a step of the clock keeps its spacing."""
    second = 10**9
    stamps = [(100, 100), (101, 101), (104, 102), (104, 104), (50, 50), (51, 51)]  # log time, time of publication, s
    items = [Item("a", log * second, published * second, i, b"") for i, (log, published) in enumerate(stamps)]
    clock, times = VirtualClock(), dict[int, float]()
    replay(in_order(items), lambda item: times.update({item.sequence: clock.now_ns() / second}), clock)
    assert times == {0: 0, 1: 1, 2: 2, 3: 4, 4: 4, 5: 5}


def test_a_long_gap_is_announced(caplog: pytest.LogCaptureFixture) -> None:
    items = [Item("a", stamp * 10**9, stamp * 10**9, 0, b"") for stamp in (1, 2, 3602)]
    replay(items, lambda item: None, VirtualClock())
    assert [record.getMessage() for record in caplog.records] == ["nothing was recorded for a while: waiting 3600 s"]


def test_replay_to_the_bus_gives_the_recorded_messages_but_no_commands(session: Path) -> None:
    bus = LocalBus()
    states = bus.subscribe(VEHICLE_STATE, depth=200)
    replay(in_order(SessionReader(session).items()), to_bus(bus), VirtualClock(), speed=0)
    assert states.poll(0) == [vehicle_state(n) for n in range(100) if n != 50]
    assert not {COMMAND.key, OPERATOR.key} & set(DEFAULT_TOPICS)
    assert TRUTH.key in DEFAULT_TOPICS
    with pytest.raises(InputError, match="unknown topic av24/nothing"):
        to_bus(bus, ["av24/nothing"])


def test_replay_to_can_sends_what_a_car_says_and_never_a_command() -> None:
    wire = VirtualWire(VirtualClock())
    sender, listener = wire.link(), wire.link()
    send = to_can(sender, load_car().codec.sent_by("car"))
    for number in (0x514, 0x578, 0x579, 0x57A, 0x57B, 0x7AB):
        send(Item(CAN_TOPIC, 0, 0, 0, pack_frame(Frame(number, bytes(8), 0), 0)))
    send(Item(CAN_TOPIC, 0, 0, 0, pack_frame(Frame(0x514, bytes(8), 0, is_error=True), 0)))
    assert [frame.id for frame in listener.receive(0.0)] == [0x514]
