"""A gateway of this user is found without flags, the answer says which, and what a killed one left is not believed."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil_gateway.config import Config, ZenohConfig
from hil_gateway.gateway.running import announced, running_gateways
from hil_gateway.process.cache import cache_directory


def port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of running gateways, in a cache with nothing of the usual one but compiled functions."""
    own, usual = tmp_path / "cache" / "hil-gateway", cache_directory()
    own.mkdir(parents=True)
    for library in usual.glob("*.so"):
        (own / library.name).symlink_to(library)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return own / "run"


class Gateway:
    """A gateway process on free ports."""

    def __init__(self, folder: Path, log: str = os.devnull) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port(socket.SOCK_STREAM)}"
        config = folder / f"{self.endpoint[-5:]}.toml"
        can = f'interface = "udp_multicast"\nmulticast_port = {port(socket.SOCK_DGRAM)}'
        config.write_text(f'[can]\n{can}\n[zenoh]\nconnect = ["{self.endpoint}"]\n')
        command = [sys.executable, "-m", "hil_gateway", "gateway", "run", "--config", str(config)]
        with Path(log).open("w") as stderr:
            self.process = subprocess.Popen(command, stderr=stderr)

    def wait_until_found(self) -> None:
        while self.process.pid not in [found.process for found in running_gateways()]:
            assert self.process.poll() is None
            time.sleep(0.05)

    def end(self, number: int) -> None:
        self.process.send_signal(number)
        self.process.wait()


def ask(action: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hil_gateway", "gateway", action]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_emergency_without_flags_reaches_the_gateway_started_last_and_names_it(tmp_path: Path) -> None:
    first = Gateway(tmp_path)
    first.wait_until_found()
    second = Gateway(tmp_path)
    second.wait_until_found()
    said = ask("emergency")
    assert (said.returncode, said.stdout.split(":")[0].strip()) == (0, "silent"), said
    assert re.search(rf"^to the gateway \(process {second.process.pid}, {second.endpoint}\)", said.stderr, re.MULTILINE)
    assert re.search(rf"^not to the gateway \(process {first.process.pid},", said.stderr, re.MULTILINE)
    second.end(signal.SIGKILL)
    assert [found.process for found in running_gateways()] == [first.process.pid], "a killed one is not believed"
    first.end(signal.SIGTERM)
    assert running_gateways() == []
    said = ask("emergency")
    assert said.returncode == 2
    assert "no gateway of this user runs here" in said.stderr.splitlines()[-1]


def test_a_log_that_cannot_be_written_ends_no_gateway(tmp_path: Path) -> None:
    gateway = Gateway(tmp_path, "/dev/full")
    gateway.wait_until_found()
    assert ask("emergency").returncode == 0  # an event, and a line of the log
    assert ask("disarm").returncode == 0
    gateway.end(signal.SIGTERM)
    assert gateway.process.returncode == 0


@pytest.mark.parametrize(
    "wrong",
    [{"start_ticks": 1}, {"boot": "another"}, {"process": 2**22 + 1}, {"endpoints": None}, {"of_later": "version"}],
)
def test_a_file_whose_process_is_another_one_is_deleted(own_cache: Path, wrong: dict[str, object]) -> None:
    with announced(Config()):
        path = own_cache / f"{os.getpid()}.json"
        assert len(running_gateways()) == 1
        path.write_text(json.dumps({**json.loads(path.read_text()), **wrong}))
        assert running_gateways() == []
        assert not path.exists()


def test_the_address_is_one_of_this_computer_and_certificates_are_said(tmp_path: Path) -> None:
    secured = ZenohConfig(connect=(), listen=("tls/0.0.0.0:7448",), extra=str(tmp_path / "gateway.json5"))
    with announced(Config(zenoh=secured)):
        assert running_gateways()[0].zenoh.connect == ("tls/127.0.0.1:7448",)
        said = ask("stop")
    assert said.returncode == 2
    assert "asks for certificates; give --config FILE" in said.stderr


def test_a_cache_that_cannot_be_written_costs_the_gateway_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc")
    with announced(Config()):
        assert running_gateways() == []
