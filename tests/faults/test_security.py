"""Zenoh over TLS as shipped: without a certificate nobody connects, with the wrong one nobody commands."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hil_gateway.bus import topics
from hil_gateway.bus.access import ROLES, secure_session
from hil_gateway.bus.interface import Subscription
from hil_gateway.bus.messages import Command, OperatorAction, OperatorCommand
from hil_gateway.bus.zenoh_bus import ZenohBus, open_bus, read_json5
from hil_gateway.config import ZenohConfig
from hil_gateway.process.errors import InputError
from hil_gateway.process.shipped import shipped

SHIPPED = Path(__file__).resolve().parents[2] / "deploy" / "zenoh"
pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is missing")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("certificates")
    subprocess.run([SHIPPED / "make-certificates.sh", folder], check=True, capture_output=True)
    return folder


@pytest.fixture
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def join(certificates, port) -> Iterator[Callable[..., ZenohBus]]:
    """Opens a bus as a role, optionally with the certificate of another."""
    with ExitStack() as stack:

        def as_role(role: str, extra: Path | None = None, protocol: str = "tls") -> ZenohBus:
            path = extra or certificates / f"{role}.json5"
            config = ZenohConfig(
                connect=(f"{protocol}/127.0.0.1:{port}",), extra="" if protocol == "tcp" else str(path)
            )
            bus = open_bus(config, role)
            stack.callback(bus.close)
            return bus

        yield as_role


def command(seq: int, source: str) -> Command:
    return Command(stamp_ns=seq, seq=seq, source=source, state_stamp_ns=seq, steer=0.0, drive=0.0)


def heard(senders: dict[str, ZenohBus], reader: Subscription[Command], seconds: float = 1.5) -> Counter[str]:
    """Everybody sends commands; who of them is heard."""
    count: Counter[str] = Counter()
    deadline, seq = time.monotonic() + seconds, 0
    while time.monotonic() < deadline:
        seq += 1
        for name, bus in senders.items():
            bus.publish(topics.COMMAND, command(seq, name))
        time.sleep(0.05)
        count.update(message.source for message in reader.poll(0))
    return count


def test_only_the_planner_commands(join):
    gateway = join("gateway")
    commands = gateway.subscribe(topics.COMMAND, 64)
    count = heard({role: join(role) for role in ROLES if role not in ("gateway", "router")}, commands)
    assert count["planner"] > 5
    assert set(count) == {"planner"}


def test_only_the_operator_arms(join):
    gateway = join("gateway")
    requests = gateway.subscribe(topics.OPERATOR, 64)
    planner, operator = join("planner"), join("operator")
    sources: Counter[str] = Counter()
    for seq in range(40):
        for name, bus in (("planner", planner), ("operator", operator)):
            bus.publish(topics.OPERATOR, OperatorCommand(stamp_ns=1, seq=seq, source=name, action=OperatorAction.ARM))
        time.sleep(0.05)
        sources.update(message.source for message in requests.poll(0))
    assert set(sources) == {"operator"}


def test_a_peer_without_a_certificate_cannot_connect(join, certificates, tmp_path):
    gateway = join("gateway")
    commands = gateway.subscribe(topics.COMMAND, 64)
    bare = json.loads(json.dumps(secure_session("planner", str(certificates))))
    for key in ("connect_private_key", "connect_certificate", "listen_private_key", "listen_certificate"):
        del bare["transport"]["link"]["tls"][key]
    bare["transport"]["link"]["tls"]["enable_mtls"] = False
    bare["listen"] = {"endpoints": []}
    path = tmp_path / "bare.json5"
    path.write_text(json.dumps(bare))
    rogue = join("planner", extra=path)
    states = rogue.subscribe(topics.OPERATOR, 8)
    plain = join("planner", protocol="tcp")
    assert heard({"rogue": rogue, "plain": plain}, commands) == Counter()
    gateway.publish(topics.OPERATOR, OperatorCommand(stamp_ns=1, seq=1, source="g", action=OperatorAction.STOP))
    time.sleep(0.3)
    assert states.poll(0) == [], "nothing may be overheard either"


def test_through_a_router_the_same_rights_hold(certificates, port):
    """A Zenoh session in router mode is what zenohd runs."""
    import zenoh

    tree = secure_session("router", str(certificates))
    tree |= {"mode": "router", "listen": {"endpoints": [f"tls/127.0.0.1:{port}"]}}
    tree["scouting"] = {"multicast": {"enabled": False}}

    def client(role: str) -> ZenohBus:
        extra = str(certificates / f"{role}.json5")
        return open_bus(ZenohConfig(mode="client", connect=(f"tls/127.0.0.1:{port}",), extra=extra), role)

    with pytest.raises(InputError, match=r"no Zenoh router at tls/127.0.0.1.*start zenohd there"):
        client("gateway")
    with zenoh.open(zenoh.Config.from_json5(json.dumps(tree))), ExitStack() as stack:
        buses = {role: client(role) for role in ("gateway", "planner", "dashboard", "estimator")}
        for bus in buses.values():
            stack.callback(bus.close)
        commands = buses["gateway"].subscribe(topics.COMMAND, 64)
        count = heard({role: bus for role, bus in buses.items() if role != "gateway"}, commands)
    assert set(count) == {"planner"}


def test_a_certificate_of_another_authority_is_no_certificate(join, tmp_path, certificates):
    gateway = join("gateway")
    commands = gateway.subscribe(topics.COMMAND, 64)
    other = tmp_path / "other"
    subprocess.run([SHIPPED / "make-certificates.sh", other], check=True, capture_output=True)
    tree = secure_session("planner", str(other))
    tree["transport"]["link"]["tls"]["root_ca_certificate"] = str(certificates / "ca.pem")
    path = tmp_path / "rogue.json5"
    path.write_text(json.dumps(tree))
    assert heard({"rogue": join("planner", extra=path)}, commands) == Counter()


def test_calling_oneself_planner_does_not_help(join, certificates):
    """The name in the message is free text; the certificate decides."""
    gateway = join("gateway")
    commands = gateway.subscribe(topics.COMMAND, 64)
    liar = join("dashboard")
    assert heard({"planner": liar}, commands) == Counter()


def test_the_shipped_file_is_the_one_derived_from_the_topics():
    tree = read_json5(shipped("hil_gateway", "data/secure.json5"))
    expected = json.dumps(secure_session("gateway", "@FOLDER@"))
    expected = expected.replace("/gateway.key", "/@ROLE@.key").replace("/gateway.pem", "/@ROLE@.pem")
    assert tree == json.loads(expected), "secure.json5 differs from hil_gateway.bus.access.secure_session"


def test_each_role_publishes_its_topics_only():
    tree = secure_session("planner", "/x")["access_control"]
    allowed = {rule["id"]: set(rule["key_exprs"]) for rule in tree["rules"] if rule["id"].startswith("publish-")}
    assert allowed["publish-planner"] == {"av24/command", "av24/plan", "av24/race_line", "av24/run"}
    assert "publish-dashboard" not in allowed
    assert sum(map(len, allowed.values())) == len(topics.TOPICS)


def test_certificate_files_that_are_not_there_are_one_clear_line(tmp_path):
    path = tmp_path / "secure.json5"
    path.write_text(json.dumps(secure_session("gateway", str(tmp_path / "nowhere"))))
    with pytest.raises(InputError, match="cannot open Zenoh"):
        open_bus(ZenohConfig(connect=("tls/127.0.0.1:7999",), extra=str(path)), "gateway")
