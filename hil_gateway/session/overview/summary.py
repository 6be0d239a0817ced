"""What happened in a session: laps, stops, alerts, model revisions, effects."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from hil_gateway.bus.alerts import grouped
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.messages import Alert, Belief, Estimate, FailsafeAction
from hil_gateway.bus.topics import (
    ALERT,
    BELIEF,
    ESTIMATE,
    EVENT,
    GATEWAY_STATUS,
    MODEL_REVISION,
    NOTE,
    RECORDER_STATUS,
    RUN,
    VEHICLE_STATE,
)
from hil_gateway.bus.track_day.run import RunPhase, RunStatus
from hil_gateway.car.states import under_yellow
from hil_gateway.car.tyre_names import named as tyre_name
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.road_speed import AT_REST
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.chunk import Messages
from hil_gateway.session.files.configuration import config_of
from hil_gateway.session.files.format import METADATA_SESSION, MessageError, unpack_message
from hil_gateway.session.files.reader import Item, SessionReader, Stream
from hil_gateway.session.overview.outing import Outing
from hil_gateway.track.lap_clock import LapClock
from hil_gateway.track.loading import DEFAULT_TRACK, load_track
from hil_gateway.track.track import Track

TOLD = (VEHICLE_STATE, ESTIMATE, EVENT, GATEWAY_STATUS, ALERT, MODEL_REVISION, BELIEF, RUN, NOTE, RECORDER_STATUS)
WANTED = frozenset(topic.key for topic in TOLD)
LOOK_NS = NS_PER_S // 10
"""between the positions, and the flags, that are looked at: often enough for lap times"""
SAMPLED = (VEHICLE_STATE.key, ESTIMATE.key)
FLAGS = re.compile(rb'"(?:track|vehicle)_flag":\d+')
"""in the JSON of a vehicle state"""
HAPPENED = (EventKind.FLAG, EventKind.PROCESS, EventKind.RECEIVER, EventKind.LEARNING)
"""what a person asks for in the evening beside stops and laps: flags, processes lost and back, what was tried"""
STOPS = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)


def session_summary(path: Path, *following: Path) -> dict[str, Any]:
    """Laps, stops, alerts and model revisions of one file and those that go on with it, ready for JSON; times in s
    since the first message.

    Raises:
        InputError: no readable recording.
    """
    readers = [SessionReader(file) for file in (path, *following)]
    run = RunStory(readers[0])
    for reader in readers:
        for messages in reader.batches():
            run.take(looked_at(reader, messages), int(messages.log_ns.min()))
    return run.tree()


class RunStory:
    """The story of the recordings of one run, of which `first` reads the first, as their messages are read."""

    def __init__(self, first: SessionReader) -> None:
        self._first = first
        self._story: Story | None = None
        self._fault = ""
        self._newest = dict.fromkeys(SAMPLED, -1)

    def take(self, items: Iterable[Item], start_ns: int) -> None:
        """What is `looked_at`, in the order of the file, whose first message was recorded at `start_ns` (Unix, ns)."""
        if self._fault:
            return
        try:
            for item in filter(self._is_due, items):
                self._story = self._story or self._begun(start_ns)
                self._story.take(item)
        except InputError as error:
            self._fault = f"{self._first.path}: {error}" if isinstance(error, MessageError) else str(error)

    def _is_due(self, item: Item) -> bool:
        """Not of a period of which one was looked at, in what was given before."""
        before, now = self._newest.get(item.topic), item.publish_ns // LOOK_NS
        if before is not None:
            self._newest[item.topic] = now
        return before != now

    def tree(self) -> dict[str, Any]:
        """For JSON.

        Raises:
            InputError: a message this version cannot read.
        """
        if self._fault:
            raise InputError(self._fault)
        session = self._first.metadata.get(METADATA_SESSION, {})
        return {
            "track": config_of(session).track or DEFAULT_TRACK,
            "started": session.get("started", ""),
            "software": session.get("software", ""),
            **(self._story or self._begun(0)).tree(),
        }

    def _begun(self, zero_ns: int) -> Story:
        config = config_of(self._first.metadata.get(METADATA_SESSION, {}))
        return Story(config, zero_ns, self._first.path.parent)


def looked_at(reader: SessionReader, messages: Messages) -> list[Item]:
    """Messages of `WANTED`, of positions and flags the first of every `LOOK_NS`."""
    chosen = reader.among(messages, lambda stream: stream.topic in WANTED)
    for topic in SAMPLED:
        rows = np.flatnonzero(reader.among(messages, partial(_is_of, topic)))
        chosen[rows] = np.diff(messages.publish_ns[rows] // LOOK_NS, prepend=-1) != 0
    return list(reader.items_of(messages, chosen))


def _is_of(topic: str, stream: Stream) -> bool:
    return stream.topic == topic


class Story:
    """What happened, message by message; `take` in the order of the file."""

    def __init__(self, config: Config, zero_ns: int, folder: Path) -> None:
        """`folder` of the recording, where the track may lie as well."""
        self._zero_ns = zero_ns
        self._track = _track(config.track) or _track(str(folder / config.track))
        self._clock = LapClock(self._track.length) if self._track else None
        self._place_s: float | None = None
        """along the track, m"""
        self._pose: Estimate | None = None
        """newest that holds as a whole"""
        self._flags = list[bytes]()
        self._yellow = False
        self._events: list[dict[str, Any]] = []
        self._stops: list[dict[str, Any]] = []
        self._action = FailsafeAction.SILENT
        self._heard = (0.0, -1)
        """when the gateway spoke last, s, and the number of its status"""
        self._alerts: list[tuple[float, Alert]] = []
        self._revisions: dict[str, dict[str, Any]] = {}
        self._belief: bytes | None = None
        self._timed: bytes | None = None
        self._outing = Outing()
        self._lost = [0]
        """frames and messages that each recorder could not write"""
        self._take = {
            VEHICLE_STATE.key: self._state, ESTIMATE.key: self._estimate, EVENT.key: self._event,
            GATEWAY_STATUS.key: self._status, ALERT.key: self._alert, MODEL_REVISION.key: self._revision,
            BELIEF.key: self._keep_belief, RUN.key: self._run, NOTE.key: self._note,
            RECORDER_STATUS.key: self._recorder,
        }  # fmt: skip

    def take(self, item: Item) -> None:
        """One message of `WANTED`."""
        self._take[item.topic](item, round((item.publish_ns - self._zero_ns) / NS_PER_S, 3))

    def tree(self) -> dict[str, Any]:
        """For JSON."""
        known = [stop for stop in self._events if stop["kind"] == EventKind.FAILSAFE]
        armed = [event["t"] for event in self._events if event["after"] == FailsafeAction.DRIVE]
        for stop in known:
            stop["again_s"] = next((round(t - stop["t"], 1) for t in armed if t > stop["t"]), None)
        return {
            **self._outing.tree(),
            "tyres_believed": [] if self._belief is None else _believed(unpack_message(BELIEF, self._belief)),
            "stops": known or self._stops,
            "lost": sum(self._lost),
            "loop_ms": None if self._timed is None else unpack_message(GATEWAY_STATUS, self._timed).loop_latency_p99_ms,
            "alerts": grouped(self._alerts),
            "revisions": list(self._revisions.values()),
            "effects": next((row["effects"] for row in reversed(self._revisions.values())), []),
            "events": self._events,
            "happened": sorted((e for e in self._events if e["kind"] in HAPPENED), key=lambda event: event["t"]),
        }

    def _estimate(self, item: Item, t_s: float) -> None:
        if self._clock is None or self._track is None:
            return
        e = unpack_message(ESTIMATE, item.data)
        self._pose = e if e.valid else None
        if e.placed and self._track.near(e.x, e.y):
            self._place_s, _ = self._track.project(e.x, e.y, self._place_s)
            lap = self._clock.update((item.publish_ns - self._zero_ns) / NS_PER_S, self._place_s, e.vx, self._yellow)
            self._outing.moved(t_s, e.vx, lap)

    def _state(self, item: Item, t_s: float) -> None:
        """Only flags that change are looked at."""
        flags = FLAGS.findall(item.data)
        if flags != self._flags or not flags:
            state = unpack_message(VEHICLE_STATE, item.data)
            self._flags, self._yellow = flags, under_yellow(state.track_flag, state.vehicle_flag)

    def _event(self, item: Item, t_s: float) -> None:
        self._log(t_s, unpack_message(EVENT, item.data))

    def _log(self, t_s: float, event: Event) -> None:
        entry = {**event.entry(0), "t": t_s}
        if entry["kind"] == EventKind.FAILSAFE:
            lap = 1 + len(self._clock.laps if self._clock else ())
            entry |= {"place_m": self._place_s, "lap": lap, "run": self._outing.run}
        self._events.append(entry)

    def _another_gateway(self, t_s: float) -> None:
        """What the one that is gone can say to nobody; a car that it drove stops by itself."""
        text = f"another gateway speaks {t_s - self._heard[0]:.1f} s later"
        lost = {"stamp_ns": 0, "seq": 0, "severity": Severity.WARNING, "text": text}
        if self._action is FailsafeAction.DRIVE:
            stop = {"before": self._action, "after": "own brakes of the car", "cause": "gateway_gone"}
            self._log(self._heard[0], Event.model_validate(lost | stop | {"kind": EventKind.FAILSAFE}))
        gone = {"kind": EventKind.PROCESS, "before": "gateway speaks", "after": "gateway silent"}
        self._log(self._heard[0], Event.model_validate(lost | gone))

    def _status(self, item: Item, t_s: float) -> None:
        """Stops of a recording without an event log; an action that has not changed is not looked at."""
        if item.sequence < self._heard[1]:
            self._another_gateway(t_s)
        self._heard = t_s, item.sequence
        if b'"loop_latency_p99_ms":null' not in item.data:
            self._timed = item.data
        if b'"action":"%s"' % self._action.encode() in item.data:
            return
        status = unpack_message(GATEWAY_STATUS, item.data)
        if status.action is not self._action and status.action in STOPS:
            self._stops.append({"t": t_s, "before": self._action, "after": status.action, "cause": status.cause})
        self._action = status.action

    def _alert(self, item: Item, t_s: float) -> None:
        self._alerts.append((t_s, unpack_message(ALERT, item.data)))

    def _revision(self, item: Item, t_s: float) -> None:
        """The one that is in use is repeated."""
        if self._revisions and b'"revision":"%s"' % next(reversed(self._revisions)).encode() in item.data:
            return
        revision = unpack_message(MODEL_REVISION, item.data)
        effects = [effect.name for effect in revision.effects]
        row = {"t": t_s, "revision": revision.revision, "effects": effects, "note": revision.provenance.note}
        row["errors"] = {
            name: [before, revision.provenance.error_after[name]]
            for name, before in revision.provenance.error_before.items()
            if name in revision.provenance.error_after
        }
        row["parameters"] = {effect.name: effect.parameters for effect in revision.effects}
        self._revisions.setdefault(revision.revision, row)

    def _keep_belief(self, item: Item, t_s: float) -> None:
        self._belief = item.data  # the last one counts, and is read then

    def _run(self, item: Item, t_s: float) -> None:
        status = unpack_message(RUN, item.data)
        self._outing.take_run(t_s, status, self._parked(status))

    def _parked(self, status: RunStatus) -> dict[str, float] | None:
        """How a car rests in the box of its run, by its own estimate: m ahead and to the left of it, rad."""
        track, e, number = self._track, self._pose, status.box or 0
        boxes = () if track is None or track.pit_lane is None else track.pit_lane.boxes
        there = status.phase is RunPhase.DONE and status.in_pit_lane and 0 < number <= len(boxes)
        if track is None or e is None or not there or abs(e.vx) > AT_REST:
            return None
        x, y, yaw = track.box_pose(boxes[number - 1])
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left = c * (e.x - x) + s * (e.y - y), c * (e.y - y) - s * (e.x - x)
        return {"box": number, "ahead_m": ahead, "left_m": left, "turned_rad": math.remainder(e.yaw - yaw, math.tau)}

    def _recorder(self, item: Item, t_s: float) -> None:
        lost = unpack_message(RECORDER_STATUS, item.data).lost
        self._lost = [*self._lost, lost] if lost < self._lost[-1] else [*self._lost[:-1], lost]

    def _note(self, item: Item, t_s: float) -> None:
        self._outing.take_note(t_s, unpack_message(NOTE, item.data))


def _believed(belief: Belief) -> list[dict[str, Any]]:
    """Tyre parameters with their deviation."""
    rows = []
    for i, (symbol, mean) in enumerate(zip(belief.names, belief.mean, strict=True)):
        name, unit = tyre_name(symbol)
        std = max(belief.covariance[i][i], 0.0) ** 0.5
        rows.append({"symbol": symbol, "name": name, "unit": unit, "mean": mean, "std": std})
    return rows


@lru_cache(maxsize=8)
def _track(name: str) -> Track | None:
    """The track it was recorded on; None where this computer does not have it. A folder's sessions share a few."""
    try:
        return load_track(name)
    except InputError:
        return None
