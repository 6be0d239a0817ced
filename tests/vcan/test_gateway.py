"""The gateway process on a real CAN interface, driven by programs that are not ours.

canplayer plays the car from a log that cantools encoded with our DBC, candump and cantools read what the gateway
sends, and the state is read on Zenoh.
"""

from __future__ import annotations

import json
import math
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from support.cars.played_car import PEER, REPORTS, played_car, write_log
from support.gateway_process import Gateway, planner
from support.promise_figures import record_figure

from benchmarks.promises.wire_judge import other_than_brakes
from hil_gateway.bus.messages import (
    FailsafeAction,
    OperatorAction,
    VehicleState,
)

pytestmark = pytest.mark.vcan
ACTUATORS = {0x578, 0x579, 0x57A, 0x57B}
COMMAND_COUNTERS = {
    "steering_cmd": "steering_motor_cmd_counter", "brake_pressure_cmd": "brk_pressure_cmd_counter",
    "accelerator_cmd": "acc_pedal_cmd_counter",
}  # fmt: skip


STEER = math.radians(13.0) / 15.0
"""rad: 13 deg of the motor, near the 12 deg the played car reports; farther off its steering counts as stuck"""


@pytest.fixture(scope="module")
def log(shared_channel: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("car") / "car.log"
    write_log(path, shared_channel)
    return path


@pytest.fixture(scope="module")
def gateway(shared_channel: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    gateway = Gateway(shared_channel, tmp_path_factory.mktemp("gateway"))
    yield gateway
    gateway.close()


Rows = list[tuple[float, int, bytes]]
"""(time s, identifier, data)"""


@contextmanager
def candump(channel: str) -> Iterator[Callable[[float], Rows]]:
    """candump listens until the block ends; the function returns the traffic of the next so many seconds.

    Started before the planner drives: a new process can hold this one up for longer than a command may be late. Waits
    until a later frame was heard: someone must be talking.
    """
    with tempfile.NamedTemporaryFile() as file, subprocess.Popen(["candump", "-L", channel], stdout=file) as process:

        def heard(seconds: float) -> Rows:
            first, rows = time.time(), Rows()
            while not rows or rows[-1][0] < first + seconds:
                assert process.poll() is None
                time.sleep(0.05)
                text = re.findall(r"\((\d+\.\d+)\) \w+ ([0-9A-F]+)#([0-9A-F]*)\n", Path(file.name).read_text())
                rows = [(float(t), int(i, 16), bytes.fromhex(data)) for t, i, data in text]
            return [row for row in rows if first <= row[0] <= first + seconds]

        try:
            heard(0.0)
            yield heard
        finally:
            process.send_signal(signal.SIGINT)


def decoded(rows: Rows, name: str) -> list[dict[str, float]]:
    message = PEER.get_message_by_name(name)
    return [message.decode(data, decode_choices=False) for _, frame_id, data in rows if frame_id == message.frame_id]


def invalid_sources(gateway: Gateway) -> set[str]:
    state = gateway.state
    return {name for name, source in state.sources.items() if not source.valid} if state else set()


def healthy_state(gateway: Gateway) -> VehicleState:
    """A state with every source valid."""
    found: list[VehicleState] = []

    def healthy() -> bool:
        state = gateway.state
        if state is not None and all(source.valid for source in state.sources.values()):
            found.append(state)
        return bool(found)

    gateway.wait(healthy)
    return found[0]


def test_state_on_zenoh_is_what_cantools_encoded(gateway: Gateway, log: Path) -> None:
    with played_car(log):
        state = healthy_state(gateway)
        status = gateway.status
    assert status is not None
    assert [getattr(state, f"wheel_speed_{w}") for w in ("fl", "fr", "rl", "rr")] == pytest.approx(
        [1.1 / 3.6, 1.2 / 3.6, 1.3 / 3.6, 1.4 / 3.6]
    )
    assert state.steer == pytest.approx(math.radians(12) / 15)
    assert (state.brake_front, state.brake_rear) == (310e3, 270e3)
    assert (state.accelerator, state.throttle) == pytest.approx((0.042, 0.075))
    assert (state.gear, state.sys_state, state.track_flag) == (1, 9, 1)
    assert state.engine_speed == pytest.approx(1500 * math.tau / 60)
    assert state.yaw_rate == pytest.approx(math.radians(1.5), abs=math.radians(0.005))
    assert state.az == pytest.approx(9.80665, abs=0.002)
    assert (status.bus, status.bus_state) == ("socketcan", "error_active")
    assert (status.frames_unknown, status.frames_malformed) == (0, 0)


@pytest.mark.promise("S5")
def test_nothing_but_race_control_and_brakes_is_said_before_arming(gateway: Gateway, log: Path) -> None:
    with played_car(log), candump(gateway.channel) as heard, planner(gateway, steer=STEER, drive=0.01):
        gateway.wait(gateway.valid)
        rows = heard(0.5)
    from_us = {frame_id for _, frame_id, _ in rows} - {PEER.get_message_by_name(name).frame_id for name in REPORTS}
    assert from_us <= {0x57C, 0x57D, 0x57E, 0x5AA} | ACTUATORS
    assert decoded(rows, "brake_pressure_cmd")[-1]["F_brake_pressure_cmd"] == 2145, "half of its weight by each axle"
    assert other_than_brakes((frame_id, data) for _, frame_id, data in rows if frame_id in ACTUATORS) == []
    assert len(rows) > 50


def disarm(gateway: Gateway) -> None:
    """Asked until it is answered: a car that reports late does not count as standing, and the request is forgotten."""

    def silent() -> bool:
        gateway.ask(OperatorAction.DISARM)
        time.sleep(0.3)
        return gateway.acts(FailsafeAction.SILENT)()

    gateway.wait(silent, 30)


def driven(gateway: Gateway, heard: Callable[[float], Rows]) -> Rows:
    """Traffic while driving; tried again when a starved machine made the failsafe stop, as it must."""

    def armed() -> bool:
        """An arming request is answered at once or forgotten: asked again where something was missing just then. A
        stop in which the played car, whose steering never moves, counts as stuck is an emergency: disarmed first."""
        stopped = gateway.acts(FailsafeAction.EMERGENCY_STOP)()
        gateway.ask(OperatorAction.DISARM if stopped else OperatorAction.ARM)
        time.sleep(0.3)
        return gateway.acts(FailsafeAction.DRIVE)()

    for _ in range(20):
        gateway.wait(armed, 30)
        time.sleep(0.2)  # the rate limits have let the command arrive
        rows = heard(0.5)
        if gateway.acts(FailsafeAction.DRIVE)():
            return rows
        disarm(gateway)
    raise AssertionError(f"never drove for a second: {gateway.status}")


@pytest.mark.promise("S4")
def test_commands_on_the_bus_are_those_of_the_planner_and_stop_with_it(gateway: Gateway, log: Path) -> None:
    """Armed by a person: counters advance by one, 10 ms apart. Planner dead: brakes, steering held."""
    with played_car(log), candump(gateway.channel) as heard:
        with planner(gateway, steer=STEER, drive=0.01):
            rows = driven(gateway, heard)
        gateway.wait(gateway.acts(FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP))
        after = heard(0.5)
        disarm(gateway)
        silent = heard(0.3)
    assert set(ACTUATORS) <= {frame_id for _, frame_id, _ in rows}
    for name, counter in COMMAND_COUNTERS.items():
        counts = [int(values[counter]) for values in decoded(rows, name)]
        assert len(counts) > 20
        assert {(b - a) % 256 for a, b in pairwise(counts)} == {1}, name
    stamps = [stamp for stamp, frame_id, _ in rows if frame_id == 0x57A]
    periods = sorted(b - a for a, b in pairwise(stamps))
    assert periods[len(periods) // 2] == pytest.approx(0.01, abs=0.002)
    wanted = math.degrees(STEER) * 15
    assert decoded(rows, "steering_cmd")[-1]["steering_motor_ang_cmd"] == pytest.approx(wanted, abs=0.5)
    assert decoded(rows, "accelerator_cmd")[-1]["acc_pedal_cmd"] > 0
    assert decoded(rows, "brake_pressure_cmd")[-1]["F_brake_pressure_cmd"] == 0
    assert decoded(after, "brake_pressure_cmd")[-1]["F_brake_pressure_cmd"] > 100
    assert decoded(after, "accelerator_cmd")[-1]["acc_pedal_cmd"] == 0
    assert other_than_brakes((frame_id, data) for _, frame_id, data in silent if frame_id in ACTUATORS) == []


@pytest.mark.promise("L7")
@pytest.mark.parametrize(
    ("loss", "repair"),
    [
        (["link set {} down"], ["link set {} up"]),
        (["link del {}"], ["link add {} type vcan", "link set {} up"]),
    ],
    ids=["down", "deleted"],
)
def test_a_lost_interface_makes_the_state_invalid_and_is_recovered_within_a_second(
    gateway: Gateway, log: Path, loss: list[str], repair: list[str]
) -> None:
    def ip(commands: list[str]) -> None:
        for command in commands:
            subprocess.run(["ip", *command.format(gateway.channel).split()], check=True, capture_output=True)

    with played_car(log):
        gateway.wait(gateway.valid)
    ip(loss)
    gateway.wait(lambda: gateway.status is not None and gateway.status.bus_state == "down")
    gateway.wait(lambda: not gateway.valid())
    ip(repair)
    recovered = gateway.wait(lambda: gateway.status is not None and gateway.status.bus_state == "error_active")
    assert recovered < 1.0
    how = "set down" if len(repair) == 1 else "deleted"
    record_figure("L7", f"interface {how} and back (vcan): state invalid meanwhile, up again after {recovered:.2f} s")
    with played_car(log):
        assert gateway.wait(gateway.valid) < 1.0 + 1.0  # canplayer itself needs a moment to start


def test_error_frames_show_in_the_status(gateway: Gateway) -> None:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as injector:
        injector.bind((gateway.channel,))
        for error_class, state in ((0x40, "bus_off"), (0x100, "error_active")):
            injector.send(struct.pack("=IB3x8s", 0x2000_0000 | error_class, 8, bytes(8)))
            gateway.wait(lambda state=state: gateway.status is not None and gateway.status.bus_state == state)


def test_frames_lost_while_the_process_was_stopped_are_counted(gateway: Gateway) -> None:
    """More frames than the kernel's queue holds while the gateway does not run: none is lost silently."""
    gateway.wait(lambda: gateway.status is not None)
    time.sleep(0.3)
    before = gateway.status
    gateway.process.send_signal(signal.SIGSTOP)
    burst = 60_000
    subprocess.run(["cangen", gateway.channel, "-g", "0", "-n", str(burst), "-I", "7F0", "-L", "8", "-i"], check=True)
    gateway.process.send_signal(signal.SIGCONT)
    time.sleep(1.0)
    subprocess.run(["cansend", gateway.channel, "7F0#00"], check=True)  # the kernel tells of losses with the next frame
    assert before is not None

    def counted() -> int:
        status = gateway.status
        assert status is not None
        return status.frames_received + status.frames_lost - before.frames_received - before.frames_lost

    gateway.wait(lambda: counted() >= burst + 1)
    time.sleep(0.3)
    assert counted() == burst + 1
    assert gateway.status is not None and gateway.status.frames_lost > before.frames_lost


def test_what_can_gw_drops_and_alters_is_noticed(gateway: Gateway, log: Path, tmp_path: Path) -> None:
    """The car behind a gateway of the kernel that drops 0x514 and freezes the counter of 0x516."""
    inner, outer = "vxgwa", "vxgwb"
    subprocess.run(["ip", "link", "add", inner, "type", "vxcan", "peer", "name", outer], check=True)
    try:
        for name in (inner, outer):
            subprocess.run(["ip", "link", "set", name, "up"], check=True)
        route = ["cangw", "-A", "-s", inner, "-d", gateway.channel, "-e"]
        subprocess.run([*route, "-f", "516:7FF", "-m", "AND:D:516.3.FFFF000000000000"], check=True)
        for name in REPORTS:
            frame_id = PEER.get_message_by_name(name).frame_id
            if frame_id not in (0x514, 0x516):
                subprocess.run([*route, "-f", f"{frame_id:03X}:7FF"], check=True)
        faulty = tmp_path / "faulty.log"
        faulty.write_text(log.read_text().replace(gateway.channel, outer))
        errors = gateway.status.counter_errors if gateway.status else 0
        with played_car(faulty):
            gateway.wait(lambda: gateway.state is not None and gateway.state.sources["imu"].valid)
            gateway.wait(lambda: gateway.status is not None and gateway.status.counter_errors > errors + 20)
            gateway.wait(lambda: invalid_sources(gateway) == {"wheel_speeds"})
            assert gateway.state is not None and not gateway.state.valid
    finally:
        subprocess.run(["cangw", "-F"], check=False)
        subprocess.run(["ip", "link", "del", inner], check=False)


def test_the_check_agrees_with_candump(shared_channel: str, log: Path) -> None:
    command = [sys.executable, "-m", "hil_gateway", "gateway", "check", "--seconds", "2", "--json"]
    command += ["--channel", shared_channel]
    pipe = subprocess.PIPE
    with (
        played_car(log),
        candump(shared_channel) as heard,
        subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as check,
    ):
        assert check.stderr is not None
        assert "nothing is sent" in check.stderr.readline()
        rows = heard(2.0)
        said, why_not = check.communicate(timeout=60)
    assert said, why_not
    report = json.loads(said)
    rates = {row["id"]: row["hz"] for row in report["messages"] if row["frames"]}
    dumped_ids = {frame_id for _, frame_id, _ in rows}
    assert {PEER.get_message_by_name(name).frame_id for name in REPORTS} <= set(rates) <= dumped_ids
    duration = rows[-1][0] - rows[0][0]
    for frame_id in (0x70, 0x514, 0x546):
        rate = sum(other == frame_id for _, other, _ in rows) / duration
        assert rates[frame_id] == pytest.approx(rate, rel=0.15)
    assert report["interface"]["kind"] == "vcan"
    assert not [row for row in report["messages"] if row["name"] in REPORTS and row["verdict"] == "fail"]
