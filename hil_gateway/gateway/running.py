"""Which gateways of this user run on this computer, and how to reach them: one small file each, beside the cache.

A file is believed only while the very process that wrote it lives: its identifier, its start time (proc(5), stat
field 22) and the boot it belongs to all have to agree. What a killed gateway left behind is deleted when it is seen.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from hil_gateway.config import Config, ZenohConfig
from hil_gateway.process.cache import cache_directory
from hil_gateway.process.lifecycle import PARENT_VARIABLE

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
ANY_ADDRESS = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}
"""address a gateway listens on everywhere -> the one of this computer"""
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunningGateway:
    """A gateway process and its end of the bus."""

    process: int
    start_ticks: int
    """clock ticks after boot at which it started"""
    boot: str
    endpoints: tuple[str, ...]
    mode: str
    secured: bool
    """it asks for certificates, which only the operator's own configuration names"""
    demo: str
    """folder of the demo it belongs to; empty: started by itself"""

    def __str__(self) -> str:
        what = f"gateway of the demo in {self.demo}" if self.demo else "gateway"
        return f"{what} (process {self.process}, {', '.join(self.endpoints)})"

    @property
    def zenoh(self) -> ZenohConfig:
        """How another process of this user reaches it."""
        return ZenohConfig.model_validate({"connect": self.endpoints, "mode": self.mode})

    @property
    def alive(self) -> bool:
        """Whether this very process still runs."""
        return self.boot == _boot() and self.start_ticks == _start_ticks(self.process)


@contextlib.contextmanager
def announced(config: Config) -> Iterator[None]:
    """Let the gateway of this process be found while the block runs; where that cannot be written, say so and go on."""
    path = _folder() / f"{os.getpid()}.json"
    temporary = path.with_suffix(".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(asdict(_this(config))), encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        log.warning("%s: %s: `hil gateway stop` needs --config to find this gateway", path, error.strerror)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def running_gateways() -> list[RunningGateway]:
    """Gateways of this user that run now, the last one started first."""
    found = []
    with contextlib.suppress(OSError):
        for path in _folder().glob("*.json"):
            gateway = _read(path)
            if gateway is not None and gateway.alive:
                found.append(gateway)
            else:
                path.unlink(missing_ok=True)
    return sorted(found, key=lambda gateway: (gateway.start_ticks, gateway.process), reverse=True)


def _folder() -> Path:
    return cache_directory() / "run"


def _this(config: Config) -> RunningGateway:
    zenoh = config.zenoh
    started = _start_ticks(os.getpid())
    assert started is not None
    return RunningGateway(
        process=os.getpid(),
        start_ticks=started,
        boot=_boot(),
        endpoints=tuple(_reachable(endpoint) for endpoint in zenoh.connect or zenoh.listen),
        mode=zenoh.mode,
        secured=bool(zenoh.extra),
        demo=config.recorder.folder if PARENT_VARIABLE in os.environ else "",
    )


def _reachable(endpoint: str) -> str:
    protocol, slash, address = endpoint.partition("/")
    host, colon, port = address.rpartition(":")
    return f"{protocol}{slash}{ANY_ADDRESS.get(host, host)}{colon}{port}"


def _read(path: Path) -> RunningGateway | None:
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        return RunningGateway(**{**tree, "endpoints": tuple(tree["endpoints"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _boot() -> str:
    return BOOT_ID.read_text().strip()


def _start_ticks(pid: int) -> int | None:
    """Start time of a process in clock ticks after boot; None when there is none of that number."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])
    except OSError:
        return None
