"""How a command asks something of a running process: where it goes, and waiting for what is answered."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from hil_gateway.bus.interface import Subscription
from hil_gateway.bus.messages import Message
from hil_gateway.config import ZenohConfig
from hil_gateway.gateway.running import running_gateways
from hil_gateway.process.errors import InputError

M = TypeVar("M", bound=Message)
ANSWER_S = 3.0
"""How long a request waits for the gateway's status."""
REPEAT_S = 0.1
"""A request is sent again until it is answered; who answers knows the second delivery of the same one."""


@dataclass(frozen=True)
class Address:
    """Where a request goes, in words, and what to do when nobody answers there."""

    zenoh: ZenohConfig
    name: str
    remedy: str


def address(asked: ZenohConfig, config: Path | None) -> Address:
    """The configured gateway where one is named, else the one of this user that was started last, else the default.

    Raises:
        InputError: it asks for certificates, and nobody has said where those of the operator are.
    """
    found = running_gateways()
    endpoints = ", ".join(asked.connect)
    if config is not None or asked != ZenohConfig():
        return Address(asked, f"configured gateway ({endpoints})", "is zenoh.connect that of the gateway?")
    if not found:
        remedy = "no gateway of this user runs here: start `hil gateway run`, or name one with --config FILE"
        return Address(asked, f"default gateway ({endpoints})", remedy)
    last, *others = found
    if last.secured:
        raise InputError(f"the {last} asks for certificates; give --config FILE with the operator's (zenoh.extra)")
    for other in others:
        print(f"not to the {other}: started earlier; --config FILE names one", file=sys.stderr)
    return Address(last.zenoh, str(last), "it runs but is silent: end its process")


def wait(
    answers: Subscription[M],
    enough: Callable[[M], bool],
    request: Callable[[], object] | None = None,
    seconds: float = ANSWER_S,
) -> M | None:
    """Newest message within `seconds`, at once when it is `enough`; with a request, from the second one on."""
    newest: M | None = None
    seen = 0
    start = asked = time.monotonic()
    least = 1 if request is None else 2
    ask = request or (lambda: None)
    ask()
    while (now := time.monotonic()) < start + seconds:
        for answer in answers.poll(time.monotonic_ns()):
            newest = answer
            seen += 1
        if newest is not None and seen >= least and enough(newest):
            return newest
        if now >= asked + REPEAT_S:
            asked = now
            ask()
        time.sleep(0.02)
    return newest
