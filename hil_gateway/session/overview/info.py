"""What a session holds: one pass, counts and rates per topic, metadata, and what is damaged."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import figure
from hil_gateway.session.files.format import CAN_TOPIC, MessageError, recorded_source
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.overview.summary import session_summary


def session_info(path: Path) -> dict[str, Any]:
    """Summary of one file, ready for JSON; times in s, sizes in B.

    Raises:
        InputError: not a readable recording.
    """
    reader = SessionReader(path)
    counts: Counter[str] = Counter()
    frames: Counter[str] = Counter()
    first, last = None, 0
    for item in reader.items():
        counts[item.topic] += 1
        if item.topic == CAN_TOPIC:
            frames[_source(item.data)] += 1
        first = item.log_ns if first is None else min(first, item.log_ns)
        last = max(last, item.log_ns)
    duration = (last - first) / NS_PER_S if first is not None else 0.0
    session = dict(reader.metadata.get("session", {}))
    damage, corrupt = [str(damage) for damage in reader.damage], not all(d.cut for d in reader.damage)
    try:
        config = json.loads(session.pop("config", "{}"))
    except ValueError:
        config, damage, corrupt = {}, [*damage, "the configuration in the metadata is not readable"], True
    return {
        "path": str(path),
        "complete": reader.complete,
        "damage": damage,
        "corrupt": corrupt,
        "bytes": path.stat().st_size,
        "start_unix_s": None if first is None else first / NS_PER_S,
        "duration_s": duration,
        "chunks": reader.chunks,
        "messages": sum(counts.values()),
        "topics": {topic: {"messages": n, "rate_hz": _rate(n, duration)} for topic, n in sorted(counts.items())},
        "frames": dict(sorted(frames.items())),
        "config": config,
        "session": session,
        "model_revision": reader.metadata.get("model_revision", {}),
        **_story(path),
    }


def _source(data: bytes) -> str:
    """Bus and direction of a frame."""
    try:
        return recorded_source(data) or "of a bus without a name"
    except MessageError:
        return "not readable"


STORY = ("laps", "best_lap_s", "stops", "alerts", "revisions", "effects", "events")


def _story(path: Path) -> dict[str, Any]:
    """What happened, where its messages are of this version."""
    try:
        summary = session_summary(path)
    except InputError as error:
        return {"story_unreadable": str(error)}
    return {name: summary[name] for name in STORY}


def _rate(count: int, duration_s: float) -> float | None:
    return round((count - 1) / duration_s, 3) if duration_s > 0 and count > 1 else None


def _origin(session: dict[str, str]) -> str:
    if source := session.get("imported_from"):
        return f"imported from {source}, channel {session.get('channel') or 'not named'},"
    bus = session.get("channel") or session.get("bus", "an unknown bus")
    return f"recorded {session.get('started', 'at an unknown time')} on {bus}"


def describe(info: dict[str, Any]) -> list[str]:
    """The summary in lines for a person."""
    session = info["session"]
    ending = "complete" if info["complete"] else "not closed in order (readable up to its last whole chunk)"
    lines = [
        f"{info['path']}: {info['duration_s']:.1f} s, {info['bytes'] / 1e6:.1f} MB, {info['messages']} messages",
        f"  {ending}",
        f"  {_origin(session)} by {session.get('software', 'unknown software')}",
    ]
    if revision := info["model_revision"].get("revision"):
        lines.append(f"  newest model revision {revision}")
    for topic, row in info["topics"].items():
        rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:8.1f} Hz"
        lines.append(f"  {topic:24} {row['messages']:9d} {rate}")
    lines += [f"  CAN frames {source:13} {number:9d}" for source, number in info["frames"].items()]
    lines += _story_lines(info)
    return lines + [f"  damaged: {damage}" for damage in info["damage"]]


def _story_lines(info: dict[str, Any]) -> list[str]:
    """Laps, stops, alerts, revisions."""
    if reason := info.get("story_unreadable"):
        return [f"  laps and stops not read: {reason}"]
    laps = [f"  lap {i}: {figure(lap['time_s'], 's', 5)}" for i, lap in enumerate(info["laps"], start=1)]
    stops = [f"  {s['after']} at {figure(s['t'], 's', 5)}: {s['cause']}{_value(s)}" for s in info["stops"]]
    alerts = [
        f"  not explained: {', '.join(a['channels'])}, up to {figure(a['strength'], '', 3)} times its noise"
        + (f"; suspected {a['suspect']}" if a["suspect"] else "")
        for a in info["alerts"]
    ]
    count, effects = len(info["revisions"]), ", ".join(info["effects"]) or "none added"
    return [*laps, *(stops or ["  no stop"]), *alerts, f"  model revisions: {count}; effects of the last: {effects}"]


def _value(stop: dict[str, Any]) -> str:
    if stop.get("measured") is None:
        return ""
    return f" ({figure(stop['measured'], stop['unit'], 3)}, limit {figure(stop['limit'], stop['unit'], 3)})"
