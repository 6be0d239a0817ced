"""Session -> the session with `foxglove.*` topics beside ours: place, car, track, lines and events for Foxglove."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil_gateway.bus.event import Event, Severity
from hil_gateway.bus.messages import Estimate, Message, Plan
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.topics import ESTIMATE, EVENT, PLAN, RACE_LINE, Topic
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.session.exchange.export import Exported
from hil_gateway.session.exchange.foxglove_schemas import schema_text
from hil_gateway.session.files.configuration import recorded_config
from hil_gateway.session.files.format import named, unpack_message
from hil_gateway.session.files.reader import Item
from hil_gateway.session.files.recover import recover
from hil_gateway.track.geodesy import LocalMap
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

LOCATION, TRANSFORM, SCENE, LOG = (f"foxglove/{name}" for name in ("location", "transform", "scene", "log"))
CHANNELS: Mapping[str, str] = {
    LOCATION: "foxglove.LocationFix",
    TRANSFORM: "foxglove.FrameTransform",
    SCENE: "foxglove.SceneUpdate",
    LOG: "foxglove.Log",
}
"""topic -> schema"""
MAP, CAR = "map", "car"
"""frames: the local map (x east, y north), and the car (x forward, y left)"""
CAR_SIZE_M = {"x": 4.9, "y": 1.9, "z": 1.2}
"""of the AV-24's box as drawn: length, width, height of a Dallara IL-15"""
STRIP, LOOP = 0, 1
"""LinePrimitive types"""
DIAGONAL = 2
"""position_covariance_type: the diagonal is known"""
FIX_EVERY = 10
"""estimates a location serves: 10 Hz"""
LEVELS = {Severity.INFO: 2, Severity.WARNING: 3, Severity.STOP: 4}
WHITE, GREY, BLUE = ((1.0, 1.0, 1.0), (0.6, 0.6, 0.6), (0.36, 0.69, 1.0))
FOREVER_S, PLAN_S = 0, 1
"""lifetimes; 0 means until another of the same name"""

Tree = dict[str, Any]
Made = tuple[str, bytes]


def export_foxglove(source: Path, target: Path) -> Exported:
    """Everything of `source`, and `CHANNELS` made of it; the count is of the messages made.

    Raises:
        InputError: no readable recording, a track that cannot be loaded, `target` cannot be written.
    """
    config = recorded_config(source)
    maker = FoxgloveMaker(load_track(config.track), LocalMap(config.origin))
    with named(source):
        done = recover(source, target, {topic: (name, schema_text(name)) for topic, name in CHANNELS.items()}, maker)
    return Exported(maker.count, {}, done.damage)


class FoxgloveMaker:
    """What one message is to Foxglove; the track goes with the first estimate."""

    def __init__(self, track: Track, local_map: LocalMap) -> None:
        self._track, self._map = track, local_map
        self._makers: Mapping[str, tuple[Topic[Any], Callable[[Any, Tree], Iterator[tuple[str, Tree]]]]] = {
            ESTIMATE.key: (ESTIMATE, self._car),
            PLAN.key: (PLAN, _plan),
            RACE_LINE.key: (RACE_LINE, _race_line),
            EVENT.key: (EVENT, _log),
        }
        self._estimates = self.count = 0

    def __call__(self, item: Item) -> Iterator[Made]:
        """(topic, JSON) made of a recorded message."""
        if item.topic in self._makers:
            topic, _ = self._makers[item.topic]
            yield from self.of(item.topic, unpack_message(topic, item.data), item.publish_ns)

    def of(self, topic: str, message: Message, unix_ns: int) -> Iterator[Made]:
        """(topic, JSON) made of a message of `topic`, stamped `unix_ns`."""
        if topic in self._makers:
            for name, tree in self._makers[topic][1](message, _stamp(unix_ns)):
                self.count += 1
                yield name, _packed(tree)

    def scenery(self, unix_ns: int) -> Made:
        """Track and car, for who comes late."""
        return SCENE, _packed(_scene(_road(self._track, _stamp(unix_ns)), _box(_stamp(unix_ns))))

    def _car(self, e: Estimate, time: Tree) -> Iterator[tuple[str, Tree]]:
        if self._estimates == 0:
            yield SCENE, _scene(_road(self._track, time), _box(time))
        turn = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * e.yaw), "w": math.cos(0.5 * e.yaw)}
        place = {"x": e.x, "y": e.y, "z": 0.0}
        frames = {"parent_frame_id": MAP, "child_frame_id": CAR}
        yield TRANSFORM, {"timestamp": time, **frames, "translation": place, "rotation": turn}
        if self._estimates % FIX_EVERY == 0:
            yield LOCATION, self._fix(e, time)
        self._estimates += 1

    def _fix(self, e: Estimate, time: Tree) -> Tree:
        latitude, longitude = self._map.to_geodetic(e.x, e.y)
        covariance = [e.std[0] ** 2, 0.0, 0.0, 0.0, e.std[1] ** 2, 0.0, 0.0, 0.0, 0.0]
        return {
            "timestamp": time, "frame_id": MAP, "latitude": latitude, "longitude": longitude, "altitude": 0.0,
            "position_covariance": covariance, "position_covariance_type": DIAGONAL,
        }  # fmt: skip


def _stamp(unix_ns: int) -> Tree:
    seconds, nanoseconds = divmod(unix_ns, NS_PER_S)
    return {"sec": seconds, "nsec": nanoseconds}


def _packed(tree: Tree) -> bytes:
    return json.dumps(tree, separators=(",", ":")).encode()


def _plan(plan: Plan, time: Tree) -> Iterator[tuple[str, Tree]]:
    yield SCENE, _scene(_lines("plan", time, PLAN_S, _line(plan.x, plan.y, STRIP, 4.0, BLUE)))


def _race_line(line: RaceLine, time: Tree) -> Iterator[tuple[str, Tree]]:
    yield SCENE, _scene(_lines("race line", time, FOREVER_S, _line(line.x, line.y, LOOP, 1.0, WHITE)))


def _log(event: Event, time: Tree) -> Iterator[tuple[str, Tree]]:
    name = {"name": str(event.kind), "file": "", "line": 0}
    yield LOG, {"timestamp": time, "level": LEVELS[event.severity], "message": event.line(), **name}


def _road(track: Track, time: Tree) -> Tree:
    edges = ((x.round(2).tolist(), y.round(2).tolist()) for x, y in track.edges())
    return _lines("track", time, FOREVER_S, *(_line(x, y, LOOP, 2.0, GREY) for x, y in edges))


def _box(time: Tree) -> Tree:
    """The car, in its own frame, from the road up."""
    pose = {**_UNTURNED, "position": {"x": 0.0, "y": 0.0, "z": 0.5 * CAR_SIZE_M["z"]}}
    return {**_entity(CAR, time, FOREVER_S, CAR), "cubes": [{"pose": pose, "size": CAR_SIZE_M, "color": _colour(BLUE)}]}


def _lines(name: str, time: Tree, lifetime_s: int, *lines: Tree) -> Tree:
    return {**_entity(name, time, lifetime_s, MAP), "lines": list(lines)}


def _entity(name: str, time: Tree, lifetime_s: int, frame: str) -> Tree:
    return {
        "timestamp": time, "frame_id": frame, "id": name, "lifetime": {"sec": lifetime_s, "nsec": 0},
        "frame_locked": True, "metadata": [], "cubes": [], "lines": [],
    }  # fmt: skip


_UNTURNED = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _line(x: Sequence[float], y: Sequence[float], kind: int, pixels: float, colour: Sequence[float]) -> Tree:
    points = [{"x": a, "y": b, "z": 0.0} for a, b in zip(x, y, strict=True)]
    return {
        "type": kind, "pose": _UNTURNED, "thickness": pixels, "scale_invariant": True, "points": points,
        "color": _colour(colour), "colors": [], "indices": [],
    }  # fmt: skip


def _colour(rgb: Sequence[float]) -> Tree:
    return {**dict(zip("rgb", rgb, strict=True)), "a": 1.0}


def _scene(*entities: Tree) -> Tree:
    return {"deletions": [], "entities": list(entities)}
