"""`hil doctor`: what this machine lacks, what for, and the remedy."""

from __future__ import annotations

import errno
import importlib.metadata
import json
import os
import platform
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from hil_gateway.config import Config, load_config
from hil_gateway.process.cache import cache_directory
from hil_gateway.process.compiled import COMPILE_TIMEOUT_S
from hil_gateway.process.errors import EXIT_FAILURE
from hil_gateway.process.figures import print_json
from hil_gateway.process.scheduling import PRIORITIES, permitted
from hil_gateway.process.shipped import missing_files, template
from hil_gateway.track.loading import shipped_tracks

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)

MIN_FREE_BYTES = 2 * 10**9
"""one hour of recording at about 500 kB/s, B"""


@dataclass(frozen=True)
class Requirement:
    """One thing looked at. `required` ones make `hil demo` impossible when they are not ok."""

    name: str
    ok: bool
    detail: str
    needed_for: str
    remedy: str = ""
    required: bool = False


@dataclass(frozen=True)
class Program:
    """A program that some part calls, and the Debian package that brings it."""

    names: tuple[str, ...]
    package: str
    needed_for: str


PROGRAMS = (
    Program(("cc", "gcc"), "gcc libc6-dev", "solver generated for this machine (about 10 times faster), vcan on AMX"),
    Program(("ip",), "iproute2", "CAN interfaces, two-computer tests"),
    Program(("candump",), "can-utils", "vcan tests with programs that are not ours"),
    Program(("chromium", "chromium-browser", "google-chrome"), "chromium", "dashboard test in a browser"),
    Program(("openssl",), "openssl", "certificates for TLS between computers"),
    Program(("systemd-analyze",), "systemd", "check of the systemd units"),
)
USER_MODE_LINUX = Program(("linux.uml",), "user-mode-linux", "vcan tests where the kernel has no CAN")


def _find(program: Program) -> str | None:
    return next((path for path in map(shutil.which, program.names) if path), None)


def _program(program: Program) -> Requirement:
    path = _find(program)
    remedy = f"apt-get install {program.package}"
    return Requirement(program.names[0], path is not None, path or "not found", program.needed_for, remedy)


def _python() -> Requirement:
    ok = sys.version_info >= (3, 11)
    return Requirement("python", ok, platform.python_version(), "everything", "install Python 3.11 or newer", True)


def _packages() -> Requirement:
    """Whether every distribution the project declares without an extra is installed."""
    declared = importlib.metadata.requires("hil-gateway") or []
    names = [_distribution(line) for line in declared if "extra ==" not in line]
    missing = [name for name in names if not _installed(name)]
    detail = f"missing: {', '.join(missing)}" if missing else f"{len(names)} installed"
    return Requirement("packages", not missing, detail, "everything", "rm -r .venv && deploy/setup.sh", True)


def _package_data() -> Requirement:
    """Whether what comes with the packages is there: tracks, database, configuration, templates."""
    missing = missing_files()
    tracks = ", ".join(shipped_tracks())
    detail = f"missing: {', '.join(missing)}" if missing else f"tracks {tracks}"
    return Requirement("package data", not missing, detail, "everything", "install the package again", True)


def _distribution(requirement: str) -> str:
    return requirement.partition(";")[0].translate({ord(c): " " for c in "[<>=!~"}).split()[0]


def _installed(name: str) -> bool:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def socketcan_available() -> bool:
    """Whether this kernel has SocketCAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def _socketcan() -> Requirement:
    ok = socketcan_available()
    remedy = "a kernel with CAN (modprobe can-raw vcan); without, the demo uses UDP multicast"
    detail = "available" if ok else "this kernel has none"
    return Requirement("socketcan", ok, detail, "a real car, vcan", remedy)


def _interface(channel: str) -> Requirement:
    ok = Path("/sys/class/net", channel).exists()
    remedy = f"ip link add dev {channel} type vcan && ip link set {channel} up (as root), or go without"
    return Requirement(channel, ok, "present" if ok else "absent", "the demo over SocketCAN", remedy)


def _user_mode_linux() -> Requirement | None:
    return None if socketcan_available() else _program(USER_MODE_LINUX)


def _multicast(group: str) -> Requirement:
    """A datagram to the group over loopback must come back."""
    remedy = "ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo (as root)"
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", 0))
            membership = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            probe.settimeout(0.5)
            probe.sendto(b"hil", (group, probe.getsockname()[1]))
            ok, detail = probe.recv(16) == b"hil", f"{group} loops back"
    except OSError as error:
        ok, detail = False, f"{group}: {error}"
    return Requirement("udp multicast", ok, detail, "the demo without SocketCAN", remedy)


def _disk(folder: str) -> Requirement:
    """Room where recordings go, or where their folder would be made."""
    try:
        place = next(p for p in Path(folder, "x").resolve().parents if p.exists())
        free, writable = shutil.disk_usage(place).free, os.access(place, os.W_OK)
    except OSError as error:
        return Requirement("disk", False, f"{folder}: {error.strerror}", "recordings", "cd to a folder that exists")
    detail = f"{free / 1e9:.1f} GB free in {place}" if writable else f"{place} cannot be written"
    return Requirement(
        "disk", writable and free > MIN_FREE_BYTES, detail, "recordings", "set recorder.folder to another one"
    )


def _cache() -> Requirement:
    """Where compiled functions are kept; without it each start runs them interpreted."""
    folder = cache_directory()
    place = next(p for p in (folder, *folder.parents) if p.exists())
    ok = place.is_dir() and os.access(place, os.W_OK) and not str(place).startswith("/proc")
    detail = str(folder) if ok else f"{place} cannot be written"
    return Requirement(
        "compiled functions", ok, detail, "planner at full speed", "set XDG_CACHE_HOME to a folder of yours"
    )


def _solver() -> Requirement:
    """Asked of the planner's own command: this package does not know the planner."""
    name, purpose = "planner's solver", "plans in a tenth of the time"
    command = [sys.executable, "-m", "hil_gateway", "plan", "solver", "--json"]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S, check=True)
        found: dict[str, str] = json.loads(child.stdout)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        return Requirement(name, False, f"not known: {error}"[:80], purpose, "hil plan solver")
    ok = not found["lacks"]
    detail = f"{found['first']}, then {found['second']}" if ok else f"{found['first']}: {found['lacks']}"
    return Requirement(name, ok, detail, purpose, "apt-get install gcc libc6-dev, or set CC to a compiler that works")


def _zenoh(endpoint: str) -> Requirement:
    """Whether the gateway may listen where the configuration says; on another computer's address it does not."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    ok, detail = True, "free"
    try:
        socket.create_server((host.strip("[]"), int(port))).close()
    except ValueError:
        ok, detail = False, "not PROTOCOL/HOST:PORT"
    except OSError as error:
        ok = error.errno == errno.EADDRNOTAVAIL
        detail = "on another computer" if ok else str(error.strerror).partition(" (")[0].lower()
    remedy = "end what listens there, or set zenoh.connect to another endpoint"
    return Requirement("zenoh endpoint", ok, f"{endpoint}: {detail}", "hil gateway run", remedy)


def _cpus() -> Requirement:
    count = len(os.sched_getaffinity(0))
    return Requirement("processors", count >= 2, str(count), "the demo in real time", "a machine with 2 cores or more")


def _real_time() -> Requirement:
    without = [f"{name} ({priority})" for name, priority in PRIORITIES.items() if not permitted(name)]
    detail = f"not permitted: {', '.join(without)}" if without else "may be raised"
    remedy = f"run by deploy/systemd, or ulimit -r {max(PRIORITIES.values())}"
    return Requirement("real-time priority", not without, detail, "a car (not the demo)", remedy)


def findings(config: Config) -> Iterator[Requirement]:
    """Look at everything, cheap things first."""
    yield from (_python(), _packages(), _package_data(), _cpus(), _disk(config.recorder.folder), _cache())
    yield from (_socketcan(), _interface(config.can.channel), _multicast(config.can.multicast_group))
    yield from map(_zenoh, config.zenoh.connect[:1])
    yield from map(_program, PROGRAMS)
    if uml := _user_mode_linux():
        yield uml
    yield _solver()
    yield _real_time()


def missing_packages() -> list[str]:
    """Debian packages that would bring the programs not found here."""
    wanted = (*PROGRAMS, *(() if socketcan_available() else (USER_MODE_LINUX,)))
    return [p.package for p in wanted if _find(p) is None]


def _print_findings(rows: list[Requirement], echo: Callable[[str], None]) -> None:
    for row in rows:
        mark = "ok  " if row.ok else ("FAIL" if row.required else "none")
        echo(f"{mark} {row.name:20} {row.detail:28} for {row.needed_for}")
        if not row.ok:
            echo(f"     {'':20} remedy: {row.remedy}")


@app.command()
def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file to read settings from")] = None,
    packages: Annotated[bool, typer.Option("--packages", help="only the Debian packages that are missing")] = False,
    template_name: Annotated[
        str, typer.Option("--template", help="print a shipped file, to edit: av24.toml, secure.json5, a layout")
    ] = "",
) -> None:
    """Say what this machine lacks for what, with the remedy. Exit 1 when `hil demo` cannot run here."""
    if template_name:
        print(template(template_name), end="")
        return
    if packages:
        print(" ".join(missing_packages()))
        return
    rows = list(findings(load_config(config_file)))
    can_run = all(row.ok for row in rows if row.required)
    if as_json:
        report: dict[str, Any] = {"ok": can_run, "checks": [asdict(row) for row in rows]}
        print_json(report)
    else:
        _print_findings(rows, print)
    if not can_run:
        raise typer.Exit(EXIT_FAILURE)
