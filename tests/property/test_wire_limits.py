"""What leaves is inside the limits, whatever comes in; what is legal passes unchanged."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from support.cars.scripted_car import ACTUATOR_IDS, PERIOD_NS, Rig
from support.promise_figures import record_figure, volume

from benchmarks.promises.wire_judge import STEPS, VALUES, Judge
from can_dbc.codec import load_codec
from hil_gateway.bus import topics
from hil_gateway.bus.messages import Command, FailsafeAction, OperatorAction
from hil_gateway.can_link import VirtualWire
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.gateway.act.limits import Limits
from hil_gateway.gateway.act.transmitter import Transmitter, transmitted
from hil_gateway.process.clock import VirtualClock
from hil_gateway.settings.gateway import LimitConfig

CAR = load_car()
HOSTILE = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e9, -1e9)


def hostile_number(rng: random.Random, scale: float) -> float:
    """Anything a float can be, often near the limits."""
    return rng.choice((rng.choice(HOSTILE), rng.gauss(0, scale), rng.uniform(-1.2, 1.2) * scale))


def transmitter_on_a_wire() -> tuple[Transmitter, Limits, object]:
    wire = VirtualWire(VirtualClock())
    link, ear = wire.link(), wire.link()
    return Transmitter(load_codec(), link, 1), Limits(CAR, LimitConfig().within(CAR)), ear


@pytest.mark.promise("S1")
def test_hostile_actuator_values_never_leave_the_limits():
    rng, judge = random.Random(1), Judge()
    transmitter, limits, ear = transmitter_on_a_wire()
    previous = limits.resting(0.0)
    count = volume(20_000, 1_000_000)
    for i in range(count):
        wanted = ActuatorPositions(
            hostile_number(rng, 4.2), hostile_number(rng, 1.0), hostile_number(rng, 6e6), hostile_number(rng, 6e6),
            rng.choice((0, 1, 3, 6, 7, -1, 10**9)),
        )  # fmt: skip
        command, _ = limits.apply(wanted, previous)
        previous, sent = transmitter.actuators(command, previous)
        assert sent
        for frame in ear.receive():
            judge.take(frame.id, frame.data)
        assert not judge.faults, (i, wanted, judge.faults)
    assert judge.frames == 4 * count
    record_figure("S1", f"{count:,} hostile actuator values, {len(judge.faults)} outside limits")


@pytest.mark.promise("S1")
def test_hostile_commands_through_the_whole_gateway_never_leave_the_limits():
    rng, judge = random.Random(2), Judge()
    rig = Rig()
    rig.drive_off(1.0)
    rig.planner_runs = False
    backlog: list[Command] = []
    sent = judged = driving = 0
    target = volume(8_000, 1_000_000)
    while sent < target:
        fresh = rig.command(rig.now_ns)
        hostile = Command.model_construct(
            **{**fresh.model_dump(), "steer": hostile_number(rng, 0.28), "drive": hostile_number(rng, 0.3),
               "source": rng.choice(("planner", "planner", "planner", "rogue"))}
        )  # fmt: skip
        backlog = [*backlog[-20:], hostile]
        batch = [hostile] * rng.choice((0, 1, 1, 1, 2)) + rng.sample(backlog, k=min(len(backlog), rng.randrange(4)))
        for command in batch:
            rig.bus.publish(topics.COMMAND, command)
        sent += len(batch)
        rig.step()
        driving += rig.action is FailsafeAction.DRIVE
        if rig.action is not FailsafeAction.DRIVE:
            rig.car.speed = 0.0
            rig.ask(OperatorAction.DISARM if rig.action is FailsafeAction.EMERGENCY_STOP else OperatorAction.ARM)
        for _, frame in rig.car.heard:
            judge.take(frame.id, frame.data)
            judged += frame.id in ACTUATOR_IDS
        rig.car.heard.clear()
        assert not judge.faults, judge.faults
        rig.car.speed = min(rig.car.speed, 60.0)
    assert judged > target and driving > 0.9 * judged / 4, "the gateway stopped driving: too little was judged"
    record_figure("S1", f"{sent:,} hostile commands through the gateway, {len(judge.faults)} outside limits")


@pytest.mark.promise("S2")
def test_a_legal_command_passes_unchanged_to_one_lsb():
    rng, judge = random.Random(3), Judge()
    transmitter, limits, ear = transmitter_on_a_wire()
    asked = dict.fromkeys(LSB, 0.0)
    previous = limits.resting(0.0)
    count = volume(20_000, 200_000)
    for _ in range(count):
        asked = legal_successor(rng, asked)
        steering, pedal, front, rear = asked.values()
        wanted = ActuatorPositions(math.radians(steering), pedal / 100, front * 1e3, rear * 1e3, 3)
        command, _ = limits.apply(wanted, previous)
        previous, _ = transmitter.actuators(command, previous)
        for frame in ear.receive():
            judge.take(frame.id, frame.data)
        apart = {name: abs(judge.last[name] - value) / LSB[name] for name, value in asked.items()}
        assert max(apart.values()) <= 1.0, (asked, apart)
    assert not judge.faults
    record_figure("S2", f"{count:,} legal commands within 1 LSB")


LSB = {"steering_motor_ang_cmd": 0.5, "acc_pedal_cmd": 0.01, "F_brake_pressure_cmd": 1.0, "R_brake_pressure_cmd": 1.0}


def legal_successor(rng: random.Random, before: dict[str, float]) -> dict[str, float]:
    """A random command that keeps every value and rate limit with one step of rounding to spare."""
    after = {}
    for name, value in before.items():
        (low, high), (rise, fall) = VALUES[name], STEPS[name]
        lsb = LSB[name]
        after[name] = rng.uniform(max(low + lsb, value - fall + 2 * lsb), min(high - lsb, value + rise - 2 * lsb))
    if rng.random() < 0.5:  # brakes off as fast as they may, so that the accelerator gets its turn
        for name in ("F_brake_pressure_cmd", "R_brake_pressure_cmd"):
            after[name] = max(0.0, before[name] - 598.0)
    if max(after["F_brake_pressure_cmd"], after["R_brake_pressure_cmd"]) > 49.0:
        after["acc_pedal_cmd"] = 0.0
    return after


@pytest.mark.promise("S3")
def test_only_declared_identifiers_and_lengths_leave():
    wire = VirtualWire(VirtualClock())
    link, ear = wire.link(), wire.link()
    transmitter = Transmitter(load_codec(), link, 1)
    declared = {load_codec().messages[name].id for name in transmitted(CAR.codec.signals)}
    for frame_id in range(2048):
        for length in range(9):
            assert transmitter.send(frame_id, bytes(length)) == (frame_id in declared and length == 8)
    left = [(frame.id, len(frame.data)) for frame in ear.receive()]
    assert sorted(left) == [(frame_id, 8) for frame_id in sorted(declared)]
    assert declared == {0x578, 0x579, 0x57A, 0x57B, 0x57C, 0x57D}
    assert transmitter.refused == 2048 * 9 - len(declared)
    record_figure("S3", f"2,048 identifiers x DLC 0..8: {len(left)} of {len(declared)} declared pass, 0 others")


@pytest.mark.promise("S4")
def test_command_counters_advance_by_one_and_frames_leave_every_10_ms():
    rig = Rig()
    rig.drive_off(6.0)
    judge = Judge()
    stamps: dict[int, list[int]] = {}
    for stamp, frame in rig.frames():
        judge.take(frame.id, frame.data)
        stamps.setdefault(frame.id, []).append(stamp)
    assert not judge.faults
    assert set(stamps) == ACTUATOR_IDS
    for times in stamps.values():
        assert {b - a for a, b in pairwise(times)} == {PERIOD_NS}
    record_figure("S4", f"{judge.frames:,} frames on the virtual clock: counters +1 mod 256, period exactly 10 ms")


class FailingLink:
    """A wire that loses what it is told to."""

    kind = "failing"

    def __init__(self, rng: random.Random) -> None:
        self.rng, self.judge, self.sent = rng, Judge(), 0

    def send(self, frame_id: int, data: bytes) -> bool:
        if self.rng.random() < 0.3:
            return False
        self.judge.take(frame_id, data)
        self.sent += 1
        return True


@pytest.mark.promise("S4")
def test_a_frame_that_could_not_leave_costs_no_counter_and_no_limit():
    rng = random.Random(4)
    link, limits = FailingLink(rng), Limits(CAR, LimitConfig().within(CAR))
    transmitter, previous = Transmitter(load_codec(), link, 1), limits.resting(0.0)
    for _ in range(5000):
        wanted = ActuatorPositions(rng.uniform(-4, 4), rng.uniform(0, 1), rng.choice((0, 5e6)), rng.choice((0, 5e6)), 3)
        command, _ = limits.apply(wanted, previous)
        previous, _ = transmitter.actuators(command, previous)
    assert transmitter.failed > 1000
    assert not link.judge.faults
    record_figure("S4", f"{link.sent:,} frames around {transmitter.failed:,} failed ones: counters +1, limits kept")


def test_gear_ratios_and_brakes_are_the_declared_ones():
    train, speed = load_car().powertrain, 6110 * 2 * math.pi / 60
    assert train.engine_torque_at(speed) * speed == pytest.approx(473 * 745.7, rel=0.01)
    assert Config().powertrain.gears == (2.917, 1.875, 1.381, 1.115, 0.96, 0.889)
