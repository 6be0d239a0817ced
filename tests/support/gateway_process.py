"""A gateway process on a CAN interface, our seat on its Zenoh bus, and a planner played to it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import (
    Command,
    Estimate,
    FailsafeAction,
    GatewayStatus,
    OperatorAction,
    OperatorCommand,
    VehicleState,
)
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config, load_config

STARTS_S = 180.0
"""A gateway has started by then: half a minute in user-mode Linux, several times that where the machine is busy."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Gateway:
    """A gateway process and our seat on its Zenoh bus."""

    def __init__(self, channel: str, folder: Path) -> None:
        self.channel = channel
        path = folder / "gateway.toml"
        path.write_text(
            f'[can]\ninterface = "socketcan"\nchannel = "{channel}"\n'
            f'[zenoh]\nconnect = ["tcp/127.0.0.1:{free_port()}"]\n'
        )
        self.config: Config = load_config(path)
        command = [sys.executable, "-m", "hil_gateway", "gateway", "run", "--config", str(path)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self.bus: Bus = open_bus(self.config.zenoh, "test")
        self._status = LatestReader(self.bus, topics.GATEWAY_STATUS)
        self._state = LatestReader(self.bus, topics.VEHICLE_STATE)
        self.wait(lambda: self.status is not None, STARTS_S)

    @property
    def status(self) -> GatewayStatus | None:
        return self._status.update(time.monotonic_ns()).message

    @property
    def state(self) -> VehicleState | None:
        return self._state.update(time.monotonic_ns()).message

    def wait(self, condition: Callable[[], bool], seconds: float = 10.0) -> float:
        """Seconds until `condition` held."""
        started = time.monotonic()
        while not condition():
            if self.process.poll() is not None:
                assert self.process.stderr is not None
                raise AssertionError(f"the gateway ended: {self.process.stderr.read()[-2000:]}")
            assert time.monotonic() < started + seconds, f"{self.status}"
            time.sleep(0.01)
        return time.monotonic() - started

    def valid(self) -> bool:
        return self.state is not None and self.state.valid

    def acts(self, *actions: FailsafeAction) -> Callable[[], bool]:
        return lambda: self.status is not None and self.status.action in actions

    def ask(self, action: OperatorAction) -> None:
        now = time.monotonic_ns()
        self.bus.publish(topics.OPERATOR, OperatorCommand(stamp_ns=now, seq=now, source="test", action=action))

    def close(self) -> None:
        self.bus.close()
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()


@contextmanager
def planner(gateway: Gateway, steer: float, drive: float) -> Iterator[None]:
    """Publishes an estimate and a command for every second state until the block ends."""
    stopped = threading.Event()
    states = gateway.bus.subscribe(topics.VEHICLE_STATE)

    def drive_on() -> None:
        seq = time.monotonic_ns()
        while not stopped.wait(0.02):
            for state in states.poll(0)[-1:]:
                seq += 1
                stamp = time.monotonic_ns()
                moves = ("yaw", "vx", "vy", "yaw_rate", "bias_ax", "bias_ay", "bias_yaw_rate")
                pose = {"x": state.position_x, "y": state.position_y} | dict.fromkeys(moves, 0.0)
                gateway.bus.publish(topics.ESTIMATE, Estimate(
                    stamp_ns=stamp, seq=seq, state_stamp_ns=state.stamp_ns, valid=True, std=(0.1,) * 9,
                    steer=0.0, drive=0.0, innovations_rejected=0, **pose,
                ))  # fmt: skip
                gateway.bus.publish(topics.COMMAND, Command(
                    stamp_ns=stamp, seq=seq, source="test", state_stamp_ns=state.stamp_ns, steer=steer, drive=drive,
                ))  # fmt: skip

    thread = threading.Thread(target=drive_on)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()
