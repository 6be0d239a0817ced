"""A recording for the page: the feed is run over it once, and what it says at every moment is kept (compressed)."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import ALERT, EVENT, OPERATOR, TOPICS, TRUTH
from hil_gateway.config import Config
from hil_gateway.dashboard.feed import Feed
from hil_gateway.dashboard.server import HEADERS, json_response, page_app, text_of
from hil_gateway.dashboard.setup import setup_of
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import named, unpack_message
from hil_gateway.session.files.reader import Item, SessionReader
from hil_gateway.session.playback.replay import in_order
from hil_gateway.track.track import Track

SHOWN = {topic.key: topic for topic in TOPICS if topic.recorded and topic not in (TRUTH, OPERATOR)}
EVERY_ONE = (ALERT.key, EVENT.key)
"""topics of which the newest message is not enough"""
SPEAK = ("gateway_status", "vehicle_state", "estimate")
"""what the figures of the page are made of"""
SLOW_EVERY = 10
"""snapshots a slow part serves"""


class Recording:
    """Snapshots of a session at the page's rate; times are s of the clock the messages are stamped with.

    Raises:
        InputError: no readable recording, or one without any topic of ours.
    """

    def __init__(self, path: Path, track: Track, config: Config) -> None:
        self.path = path
        self.times: list[float] = []
        self.opens_s = 0.0
        """the newest moment that says most: at the end of a session one process goes after the other"""
        self._most_said = 0
        self._quick: list[bytes] = []
        self._slow: list[bytes] = []
        self.lines: dict[str, dict[str, Any]] = {}
        """race lines by name"""
        bus = LocalBus()
        reader = SessionReader(path, frozenset(SHOWN))
        moments = _moments(in_order(reader.items()), 1 / config.dashboard.rate_hz)
        feed = Feed(bus, track, config, minutes=24 * 60)
        with named(path):
            for t_s, items in moments:
                for item in items:
                    bus.publish(SHOWN[item.topic], unpack_message(SHOWN[item.topic], item.data))
                self._keep(feed, t_s)
        if not self.times:
            reason = "holds no message of the loop; `hil session import --estimate` makes them of raw frames"
            raise InputError(f"{path}: {reason}")
        self.history, last = feed.history(), feed.slow()
        self._last_slow = zlib.compress(text_of(last).encode(), 1)
        self.events, self.laps = last["events"], last["laps"]

    def at(self, t_s: float) -> str:
        """Both parts of the newest snapshot at or before `t_s`, as JSON."""
        i = max(bisect_right(self.times, t_s) - 1, 0)
        last = i == len(self.times) - 1
        parts = self._quick[i], self._last_slow if last else self._slow[i // SLOW_EVERY]
        quick, slow = (zlib.decompress(part).decode() for part in parts)
        return f'{{"quick":{quick},"slow":{slow}}}'

    def _keep(self, feed: Feed, t_s: float) -> None:
        snapshot = feed.snapshot(round(t_s * NS_PER_S))
        if len(self.times) % SLOW_EVERY == 0:
            slow = feed.slow()
            if line := feed.line(slow["line"]):
                self.lines[slow["line"]] = line
            self._slow.append(zlib.compress(text_of(slow).encode(), 1))
        self.times.append(t_s)
        said = sum(age["alive"] for name, age in snapshot["ages"].items() if name in SPEAK)
        if said >= self._most_said:
            self._most_said, self.opens_s = said, t_s
        self._quick.append(zlib.compress(text_of(snapshot).encode(), 1))


def _moments(items: Iterator[Item], step_s: float) -> Iterator[tuple[float, list[Item]]]:
    """(time, what arrived in the step before it): the newest message of each topic, and every event and alert."""
    offset_ns, due_s = 0, 0.0
    newest: dict[str, Item] = {}
    listed: list[Item] = []
    for item in items:
        if due_s == 0.0:
            offset_ns = item.publish_ns - unpack_message(SHOWN[item.topic], item.data).stamp_ns
            due_s = round((item.publish_ns - offset_ns) / NS_PER_S, 1) + step_s
        t_s = (item.publish_ns - offset_ns) / NS_PER_S
        while t_s >= due_s:
            yield due_s, [*newest.values(), *listed]
            newest, listed, due_s = {}, [], round(due_s + step_s, 6)
        if item.topic in EVERY_ONE:
            listed.append(item)
        else:
            newest[item.topic] = item


def create_app(recording: Recording, track: Track, config: Config, limit_s: float | None = None) -> Starlette:
    """The page over a recording: the history is all of it, a moment is asked for by its time."""

    def at(request: Request) -> Response:
        try:
            t_s = float(request.query_params.get("t", "0"))
        except ValueError:
            return Response("t is no number", 400, HEADERS)
        return Response(recording.at(t_s), media_type="application/json", headers=HEADERS)

    source = {"file": recording.path.name, "start_s": recording.times[0], "end_s": recording.times[-1]}
    source["opens_s"] = recording.opens_s
    routes = [
        Route("/at.json", at),
        Route("/history.json", lambda request: json_response(recording.history)),
        Route("/line.json", lambda request: json_response(recording.lines.get(request.query_params.get("name", "")))),
    ]
    return page_app(setup_of(track, config, source, limit_s), routes)
