"""Alerts for people: one line for each effect that is suspected and each channel that nothing explains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hil_gateway.bus.messages import Alert


def grouped(alerts: Sequence[tuple[float, Alert]]) -> list[dict[str, Any]]:
    """`alerts` as (time in s, message), oldest first -> lines, the newest first.

    Where one effect is suspected the channels it shows in are one line; conditions are listed once.
    """
    groups: dict[tuple[str, str], dict[str, Any]] = {}
    for t, alert in alerts:
        key = (alert.suspected_effect, "" if alert.suspected_effect else alert.channel)
        line = groups.setdefault(
            key, {"suspect": alert.suspected_effect, "channels": [], "conditions": [], "strength": 0.0, "first": t}
        )
        line["last"] = t
        line["strength"] = max(line["strength"], round(alert.strength, 1))
        for name, value in (("channels", alert.channel), ("conditions", alert.condition)):
            if value not in line[name]:
                line[name].append(value)
    return _not_superseded(sorted(groups.values(), key=lambda line: -line["last"]))


def _not_superseded(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Without the suspects of which every channel has since been put down to another effect."""
    kept: list[dict[str, Any]] = []
    for line in lines:
        explained = {channel for newer in kept if newer["suspect"] for channel in newer["channels"]}
        if not (line["suspect"] and explained.issuperset(line["channels"])):
            kept.append(line)
    return kept
