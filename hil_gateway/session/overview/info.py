"""What a session holds: one pass, counts and rates per topic, metadata, and what is damaged."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Bools
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import figure, lap_time
from hil_gateway.session.exchange.importer import open_named
from hil_gateway.session.files.chunk import MESSAGE, Messages
from hil_gateway.session.files.format import MessageError, recorded_source, source_places
from hil_gateway.session.files.reader import Item, SessionReader, Stream
from hil_gateway.session.files.two_readers import in_turn
from hil_gateway.session.logs.bag import KINDS
from hil_gateway.session.logs.entry import CUT_OFF
from hil_gateway.session.logs.raw_bag import Bag, bag_files, is_mcap, is_recording, is_sqlite
from hil_gateway.session.logs.source import Source
from hil_gateway.session.overview.summary import RunStory, looked_at
from hil_gateway.session.run import run_of, runs_below
from hil_gateway.track.lap_clock import Mark


def session_infos(path: Path, car: Car) -> list[dict[str, Any]]:
    """Summaries of a file with those that go on with it, or of every run in a folder and below it.

    Raises:
        InputError: not a readable recording or log.
    """
    if not path.is_dir():
        return [session_info(*run_of(path), car=car) if is_recording(Source(path)) else session_info(path, car=car)]
    return [session_info(*run, car=car) for run in runs_below(path)] or [session_info(path, car=car)]


def session_info(path: Path, *following: Path, car: Car) -> dict[str, Any]:
    """Summary of one file, ready for JSON; times in s, sizes in B. `following`: recordings that go on with it.

    A CAN log of another program has the same keys as a recording, with its frames by bus.

    Raises:
        InputError: not a readable recording or log.
    """
    if path.is_dir() or is_sqlite(Source(path)):
        return bag_info(path)
    return recording_info(path, *following) if is_mcap(Source(path)) else log_info(path, car)


def bag_info(path: Path) -> dict[str, Any]:
    """The same of a ROS 2 bag in SQLite, or in a folder of parts."""
    bag, seen = Bag(path), _SeenTopics()
    for item in bag.items():
        seen.note(item)
    return _tree(path, "ROS 2 bag", seen.start_ns, seen.end_ns) | seen.tree() | {"damage": bag.damage}


def log_info(path: Path, car: Car) -> dict[str, Any]:
    """The same of a CAN log of any kind, whose messages may be named as those of `car`."""
    log, buses, stamps = open_named(path, car), Counter[str](), [1 << 63, 0]
    for entry in log.frames():
        buses[f"{entry.channel or 'of a bus without a name'}{' errors' if entry.frame.is_error else ''}"] += 1
        stamps = [min(stamps[0], entry.frame.stamp_ns), max(stamps[1], entry.frame.stamp_ns)]
    if not buses:
        raise InputError(f"{path}: holds no CAN frames")
    frames = {"messages": buses.total(), "frames": dict(sorted(buses.items())), "left_out": dict(log.left_out)}
    cut = {"complete": CUT_OFF.kind not in log.left_out, "notes": log.notes}
    return _tree(path, log.format, *stamps) | frames | cut


def _tree(path: Path, kind: str, start_ns: int | None, end_ns: int) -> dict[str, Any]:
    """What is said of any file, with nothing of what only some have."""
    return {
        "path": str(path), "format": kind, "complete": True, "damage": [], "corrupt": False, "notes": [],
        "bytes": sum(file.stat().st_size for file in bag_files(path)),
        "start_unix_s": None if start_ns is None else start_ns / NS_PER_S,
        "duration_s": 0.0 if start_ns is None else (end_ns - start_ns) / NS_PER_S,
        "files": [str(path)], "gaps": [], "messages": 0, "frames": {}, "left_out": {}, "chunks": 0, "topics": {},
        "config": {}, "session": {}, "model_revision": {}, **_NO_STORY,
    }  # fmt: skip


@dataclass
class _SeenTopics:
    """Messages counted by topic, frames by bus and direction; Unix ns of the first and the last."""

    topics: Counter[str] = field(default_factory=Counter)
    frames: Counter[str] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int = 0

    def note(self, item: Item) -> None:
        """Count one message."""
        self.topics[item.topic] += 1
        if item.stream.kind in KINDS:
            self.frames[_source(item.data)] += 1
        self._span(item.log_ns, item.log_ns)

    def note_all(self, messages: Messages, streams: Mapping[int, Stream]) -> None:
        """Count messages of these streams, by their number."""
        for number in np.flatnonzero(messages.counts).tolist():
            stream = streams.get(number) or Stream(f"channel {number}")
            self.topics[stream.topic] += int(messages.counts[number])
            if stream.kind in KINDS:
                self.frames += _sources(messages, messages.channel == number)
        self._span(int(messages.log_ns.min()), int(messages.log_ns.max()))

    def add(self, further: _SeenTopics) -> None:
        """Count what was counted elsewhere; it is not empty."""
        self.topics += further.topics
        self.frames += further.frames
        self._span(further.start_ns or 0, further.end_ns)

    def _span(self, start_ns: int, end_ns: int) -> None:
        self.start_ns = start_ns if self.start_ns is None else min(self.start_ns, start_ns)
        self.end_ns = max(self.end_ns, end_ns)

    def tree(self) -> dict[str, Any]:
        """The counts, ready for JSON."""
        duration_s = 0.0 if self.start_ns is None else (self.end_ns - self.start_ns) / NS_PER_S
        rates = {t: {"messages": n, "rate_hz": _rate(n, duration_s)} for t, n in sorted(self.topics.items())}
        return {"messages": self.topics.total(), "topics": rates, "frames": dict(sorted(self.frames.items()))}


def recording_info(*files: Path) -> dict[str, Any]:
    """The same of the recordings of one run, in order of time."""
    readers, seen, gaps = [SessionReader(path) for path in files], _SeenTopics(), []
    story = RunStory(readers[0])
    for reader in readers:
        before_ns = seen.end_ns
        for number, held in enumerate(in_turn(reader, _held)):
            if number == 0 and before_ns:
                gap_ns = held.first_ns - before_ns
                at_s = (before_ns - (seen.start_ns or 0)) / NS_PER_S
                gaps.append({"before": reader.path.name, "t": round(at_s, 3), "seconds": round(gap_ns / NS_PER_S, 3)})
            seen.add(held.seen)
            story.take(held.items, seen.start_ns or 0)
    first, newest = readers[0], readers[-1]
    session = dict(first.metadata.get("session", {}))
    damage = [(f"{reader.path.name}: " if len(files) > 1 else "") + str(d) for reader in readers for d in reader.damage]
    corrupt = not all(d.cut for reader in readers for d in reader.damage)
    try:
        config = json.loads(session.pop("config", "{}"))
    except ValueError:
        config, damage, corrupt = {}, [*damage, "the configuration in the metadata is not readable"], True
    kind = RECORDING if first.ours else f"MCAP of another program, profile {first.profile or 'not named'}"
    return {
        **_tree(files[0], kind, seen.start_ns, seen.end_ns), **seen.tree(),
        "files": list(map(str, files)), "gaps": gaps, "bytes": sum(path.stat().st_size for path in files),
        "complete": all(r.complete for r in readers), "damage": damage, "corrupt": corrupt,
        "chunks": sum(r.chunks for r in readers),
        "config": config, "session": session, "model_revision": newest.metadata.get("model_revision", {}),
        **(_story(story) if first.ours else {}),
    }  # fmt: skip


@dataclass(frozen=True)
class _Held:
    """What is taken of messages that were read together: their numbers, the first's time of logging in Unix ns, and
    those the story is told by."""

    first_ns: int
    seen: _SeenTopics
    items: list[Item]


def _held(reader: SessionReader, messages: Messages) -> _Held:
    seen = _SeenTopics()
    seen.note_all(messages, reader.streams)
    return _Held(int(messages.log_ns[0]), seen, looked_at(reader, messages) if reader.ours else [])


def _sources(messages: Messages, chosen: Bools) -> Counter[str]:
    """Frames among the `chosen` (n,) messages, by bus and direction."""
    found, at = Counter[str](), messages.at[chosen] + MESSAGE.size
    size = messages.size[chosen] - MESSAGE.size
    while len(at):
        frame = messages.data[int(at[0]) : int(at[0] + size[0])]
        alike = np.flatnonzero(size == size[0])
        for place, length in source_places(frame):
            pieces = messages.pieces(at[alike] + place, length)
            alike = alike[pieces == pieces[0]]
        found[_source(frame)] += len(alike)
        at, size = np.delete(at, alike), np.delete(size, alike)
    return found


def _source(data: bytes) -> str:
    """Bus and direction of a frame."""
    try:
        return recorded_source(data) or "of a bus without a name"
    except MessageError:
        return "not readable"


RECORDING = "recording"
STORY = (
    "laps", "best_lap_s", "runs", "remarks", "tyres", "km", "top_speed", "stops", "alerts", "revisions", "effects",
    "events", "happened", "tyres_believed", "weather", "loop_ms", "lost",
)  # fmt: skip
_NO_STORY: dict[str, Any] = {name: [] for name in STORY} | {
    "best_lap_s": None, "km": None, "top_speed": None, "tyres": {}, "weather": {}, "loop_ms": None, "lost": None,
}  # fmt: skip


def _story(run: RunStory) -> dict[str, Any]:
    """What happened, where its messages are of this version."""
    try:
        summary = run.tree()
    except InputError as error:
        return {"story_unreadable": str(error)}
    return {name: summary[name] for name in STORY}


def _rate(count: int, duration_s: float) -> float | None:
    return round((count - 1) / duration_s, 3) if duration_s > 0 and count > 1 else None


def _origin(session: dict[str, str]) -> str:
    by = session.get("software", "unknown software")
    if source := session.get("imported_from"):
        name = session.get("channel") or "not named"
        return f"imported from {source}, channel {name}, by {by}"
    bus = session.get("channel") or session.get("bus", "an unknown bus")
    return f"recorded {session.get('started', 'at an unknown time')} on {bus} by {by}"


def describe(info: dict[str, Any]) -> list[str]:
    """The summary in lines for a person."""
    session = info["session"]
    ours = info["format"] == RECORDING
    ending = "complete" if info["complete"] else "not closed in order (readable up to its last whole chunk)"
    lines = [
        f"{info['path']}: {info['duration_s']:.1f} s, {info['bytes'] / 1e6:.1f} MB, {info['messages']} messages",
        f"  {ending}",
        f"  {_origin(session) if ours else info['format']}",
    ]
    for name, gap in zip(info["files"][1:], info["gaps"], strict=False):
        lines.append(f"  goes on in {Path(name).name} after {gap['seconds']:.2f} s without a recording")
    if revision := info["model_revision"].get("revision"):
        lines.append(f"  newest model revision {revision}")
    for topic, row in info["topics"].items():
        rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:8.1f} Hz"
        lines.append(f"  {topic:24} {row['messages']:9d} {rate}")
    lines += [f"  CAN frames {source:13} {number:9d}" for source, number in info["frames"].items()]
    lines += [f"  {note}" for note in info["notes"]]
    lines += [f"  left out: {reason}, {count} times" for reason, count in info["left_out"].items()]
    lines += _story_lines(info) if ours else []
    return lines + [f"  damaged: {damage}" for damage in info["damage"]]


def _story_lines(info: dict[str, Any]) -> list[str]:
    """Laps, stops, alerts, revisions."""
    if reason := info.get("story_unreadable"):
        return [f"  laps and stops not read: {reason}"]
    laps = [f"  lap {i}: {lap_time(lap['time_s'])}{marked(lap)}" for i, lap in enumerate(info["laps"], start=1)]
    stops = [f"  {s['after']} at {figure(s['t'], 's', 5)}: {s['cause']}{_value(s)}" for s in info["stops"]]
    alerts = [
        f"  not explained: {', '.join(a['channels'])}, up to {figure(a['strength'], '', 3)} times its noise"
        + (f"; suspected {a['suspect']}" if a["suspect"] else "")
        for a in info["alerts"]
    ]
    count, effects = len(info["revisions"]), ", ".join(info["effects"]) or "none added"
    notes = [f"  note at {figure(note['t'], 's', 5)}: {note_words(note)}" for note in info["remarks"]]
    models = f"  model revisions: {count}; effects of the last: {effects}"
    return [*laps, *notes, *(stops or ["  no stop"]), *alerts, models]


def note_words(note: dict[str, Any]) -> str:
    """A note in words."""
    named = {"tyres": "tyre set {}", "air_c": "air {:g} deg C", "road_c": "road {:g} deg C"}
    further = [words.format(note[key]) for key, words in named.items() if note.get(key) not in ("", None)]
    return "; ".join(text for text in (note["text"], *further) if text)


def marked(lap: dict[str, Any]) -> str:
    """What keeps a lap from counting as one, in words behind its time."""
    words = {Mark.FROM_REST: "from rest, not from the line", Mark.STOP: f"stood for {lap['stood_s']:.0f} s"}
    words[Mark.GAP] = "its place unknown for a while"
    return "".join(f", {words.get(mark, mark)}" for mark in lap["marks"])


def _value(stop: dict[str, Any]) -> str:
    if stop.get("measured") is None:
        return ""
    return f" ({figure(stop['measured'], stop['unit'], 3)}, limit {figure(stop['limit'], stop['unit'], 3)})"
