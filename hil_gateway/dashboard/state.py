"""Whether what the page shows is live: LIVE, REPLAY, FROZEN, LOST or WAITING, with the reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.topics import GATEWAY_STATUS, PLAYBACK, VEHICLE_STATE
from hil_gateway.process.figures import figure

FROZEN_S = 0.5
"""reports of the car older than this: the figures stand still while the gateway itself runs"""


def state_of(newest: Mapping[str, Latest[Any]], now_ns: int) -> dict[str, str]:
    """`name` and, in words, `why`; the gateway and the car's reports decide, the plan never makes anything live."""
    playback, status, state = (newest[topic.key] for topic in (PLAYBACK, GATEWAY_STATUS, VEHICLE_STATE))
    if playback.alive(now_ns) and playback.message is not None:
        at = figure(playback.message.position_s, "s", 4)
        return _state("REPLAY", f"recording {playback.message.file}, at {at}: nothing here is live")
    if status.message is None:
        return _state("WAITING", "no word from a gateway yet: `hil gateway run`")
    if not status.alive(now_ns):
        age = figure(status.age_s(now_ns), "s", 3)
        return _state("LOST", f"no word from the gateway for {age}; what is shown is old")
    youngest_s = _youngest_report_s(state)
    if youngest_s is None:
        return _state("WAITING", "the gateway runs, the car has not spoken yet")
    silent_s = youngest_s + state.age_s(now_ns)
    if silent_s > FROZEN_S:
        return _state("FROZEN", f"the gateway runs, the car has been silent for {figure(silent_s, 's', 3)}")
    return _state("LIVE", "")


def _state(name: str, why: str) -> dict[str, str]:
    return {"name": name, "why": why}


def _youngest_report_s(state: Latest[Any]) -> float | None:
    """Age of the youngest report when the newest vehicle state was made; None before the first."""
    ages = [] if state.message is None else [s.age_s for s in state.message.sources.values() if s.age_s is not None]
    return min(ages, default=None)
