"""What the page shows, gathered from the bus: a quick part ten times a second, and a slow one once a second."""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Mapping
from typing import Any

from hil_gateway.bus.alerts import grouped
from hil_gateway.bus.event import Event, EventKind
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Alert, Belief, Estimate, Message, Plan, VehicleState
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.topics import (
    ALERT,
    BELIEF,
    ESTIMATE,
    EVENT,
    GATEWAY_STATUS,
    MODEL_PROPOSAL,
    OPERATOR,
    PLAYBACK,
    RACE_LINE,
    TOPICS,
    TRUTH,
    VEHICLE_STATE,
)
from hil_gateway.car.states import under_yellow
from hil_gateway.car.tyre_names import named
from hil_gateway.config import Config
from hil_gateway.dashboard.channels import asked_speed, grip_used, row_of, slip_angles
from hil_gateway.dashboard.history import MINUTES, History, StopStory
from hil_gateway.dashboard.phase import phase_of
from hil_gateway.dashboard.setup import edges
from hil_gateway.dashboard.tyre_curve import curves
from hil_gateway.process.clock import NS_PER_S, Clock
from hil_gateway.process.figures import figure
from hil_gateway.track.lap_clock import LapClock
from hil_gateway.track.track import Track

KEPT = 300
SAME_CLOCK_S = 1.0
"""a stamp this close to the time of receipt is of the clock of this computer, and tells the age to the millisecond"""


class Feed:
    """Newest message of every topic but the plant's truth, which belongs to the referee alone."""

    def __init__(self, bus: Bus, track: Track, config: Config, minutes: float = MINUTES) -> None:
        as_events = (ALERT, OPERATOR, EVENT, MODEL_PROPOSAL)
        self._readers = {t.key: LatestReader(bus, t) for t in TOPICS if t not in (TRUTH, *as_events)}
        self._alert_queue, self._event_queue = bus.subscribe(ALERT, depth=64), bus.subscribe(EVENT, depth=256)
        self._alerts: deque[tuple[float, Alert]] = deque(maxlen=KEPT)
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._stops = StopStory()
        self._line = LineShown(track)
        self._prior: Belief | None = None
        self._vehicle, self._track = config.vehicle, track
        self._clock = LapClock(track.length)
        self._s: float | None = None
        self._history = History(round(60 * minutes * config.dashboard.rate_hz))

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """Everything that changes quickly; adds a row to the history. Ages in s, null before the first message."""
        for reader in self._readers.values():
            reader.update(now_ns)
        newest = {key: reader.latest for key, reader in self._readers.items()}
        alive = {key: latest.message for key, latest in newest.items() if latest.alive(now_ns)}
        self._take_events(now_ns, alive.get(ESTIMATE.key))
        self._line.take(newest[RACE_LINE.key].message)
        row = self._row(now_ns, alive)
        self._history.add(row)
        lap = self._lap(now_ns / NS_PER_S, row)
        return {
            "t": row["t"],
            "state": state_of(newest, now_ns),
            "phase": phase_of(alive, lap["current_s"] is not None),
            "row": row,
            "place": self._place(alive.get(ESTIMATE.key)),
            "lap": lap,
            "messages": {_short(key): _page_form(latest.message) for key, latest in newest.items()},
            "ages": {_short(key): _age(latest, now_ns) for key, latest in newest.items()},
        }

    def slow(self) -> dict[str, Any]:
        """What changes seldom: events, laps, alerts, stops, tyres."""
        belief = self._readers[BELIEF.key].latest.message
        if belief and (self._prior is None or self._prior.names != belief.names):  # another estimator speaks now
            self._prior = belief
        return {
            "events": list(self._events),
            "laps": [lap.tree() for lap in self._clock.laps[-50:]],
            "alerts": grouped(list(self._alerts)),
            "stop": {"first": self._stops.first, "last": self._stops.last},
            "tyres": _tyres(belief, self._prior) if belief and self._prior else None,
            "line": self._line.name,
        }

    def line(self, name: str) -> dict[str, Any] | None:
        """Race line and corridor called `name` by the slow part; None where that one is not known any more."""
        return self._line.drawn if name and name == self._line.name else None

    def history(self) -> dict[str, Any]:
        """Columns of the last minutes."""
        return self._history.columns()

    def _take_events(self, now_ns: int, estimate: Estimate | None) -> None:
        place = (None, None) if estimate is None else (round(estimate.x, 1), round(estimate.y, 1))
        for event in self._event_queue.poll(now_ns):
            self._note(event, place)
        self._alerts.extend((now_ns / NS_PER_S, alert) for alert in self._alert_queue.poll(now_ns))

    def _note(self, event: Event, place: tuple[float | None, float | None]) -> None:
        self._stops.take(event)
        marked = event.kind in (EventKind.FAILSAFE, EventKind.ALERT)
        self._events.append({**event.entry(0), "x": place[0] if marked else None, "y": place[1] if marked else None})

    def _row(self, now_ns: int, alive: dict[str, Any]) -> dict[str, float | None]:
        """The newest row of the history; everything of a silent source is null."""
        t_s, e = now_ns / NS_PER_S, alive.get(ESTIMATE.key)
        row: dict[str, float | None] = {"t": round(t_s, 3), **row_of(alive)}
        row["slip_front"], row["slip_rear"] = slip_angles(alive, self._vehicle)
        row["grip"] = grip_used(alive, self._vehicle)
        row["s"] = row["delta"] = row["line_speed"] = None
        if e is not None and e.placed and self._track.near(e.x, e.y):
            along, _ = self._track.project(e.x, e.y, self._s)
            state = alive.get(VEHICLE_STATE.key)
            yellow = state is not None and under_yellow(state.track_flag, state.vehicle_flag)
            self._clock.update(t_s, along, e.vx, yellow)
            delta = self._clock.delta_s(t_s, along)
            self._s, row["s"] = along, round(along, 1)
            row["line_speed"] = asked_speed(alive, along, self._track.length)
            row["delta"] = None if delta is None else round(delta, 3)
        else:
            self._s = None
        return row

    def _place(self, e: Estimate | None) -> dict[str, Any] | None:
        """How the car stands on the track: m to the left of its middle, degrees to the left of its direction, with the
        deviation of that, and what is not known; None where no estimate is alive."""
        if e is None or not self._track.near(e.x, e.y):
            return None
        along, lateral = self._track.project(e.x, e.y, self._s)
        across = math.remainder(e.yaw - float(self._track.at(along).heading), math.tau)
        return {
            "lateral_m": round(lateral, 2), "across_deg": round(math.degrees(across), 1),
            "heading_std_deg": round(math.degrees(e.std[2]), 1), "lacks": e.lacks,
        }  # fmt: skip

    def _lap(self, t_s: float, row: dict[str, float | None]) -> dict[str, Any]:
        laps, best = self._clock.laps, self._clock.best
        return {
            "number": len(laps) + 1,
            "current_s": self._clock.current_s(t_s) if row["s"] is not None else None,
            "last_s": laps[-1].time_s if laps else None,
            "best_s": best.time_s if best else None,
            "delta_s": row["delta"],
        }


class Live:
    """A feed on a running clock, as the page's server asks for it."""

    def __init__(self, feed: Feed, clock: Clock) -> None:
        self._feed, self._clock = feed, clock
        self.slow, self.history, self.line = feed.slow, feed.history, feed.line

    def snapshot(self) -> dict[str, Any]:
        """The quick part, of now."""
        return self._feed.snapshot(self._clock.now_ns())


def _short(key: str) -> str:
    return key.removeprefix("av24/")


def _age(latest: Latest[Any], now_ns: int) -> dict[str, Any]:
    """Age of the newest message: by its stamp where that is of this computer's clock, else since it was picked up."""
    if latest.message is None:
        return {"age_s": None, "alive": False}
    received_s, stamped_s = latest.age_s(now_ns), (now_ns - latest.message.stamp_ns) / NS_PER_S
    same_clock = received_s <= stamped_s <= received_s + SAME_CLOCK_S
    return {"age_s": round(stamped_s if same_clock else received_s, 4), "alive": latest.alive(now_ns)}


DRAWN: dict[type[Message], set[str]] = {
    Belief: {"samples", "log_det_information"},
    RaceLine: {"lap_time_s"},
    VehicleState: {"valid", "sources", "sys_state", "ct_state", "gear"},
}
"""fields of messages of which not all is drawn"""


def _page_form(message: Any) -> dict[str, Any] | None:
    """A message as the page wants it: nothing that is not drawn."""
    if message is None:
        return None
    if isinstance(message, Plan):
        tree = message.model_dump(mode="json", include={"status", "reason", "solve_ms", "lap", "revision"})
        return tree | {name: [round(v, 2) for v in getattr(message, name)] for name in ("x", "y", "vx")}
    tree = dict(message.model_dump(mode="json", include=DRAWN.get(type(message)), exclude={"covariance", "std"}))
    return tree | {"std": message.std[:3]} if isinstance(message, Estimate) else tree


def _tyres(belief: Belief, prior: Belief) -> dict[str, Any]:
    """Parameters with names and units, now and as first heard, and the curves they make."""
    rows = []
    for i, (symbol, mean, first) in enumerate(zip(belief.names, belief.mean, prior.mean, strict=True)):
        std = math.sqrt(max(belief.covariance[i][i], 0.0))
        name, unit = named(symbol)
        rows.append({"symbol": symbol, "name": name, "unit": unit, "mean": mean, "std": std, "first": first})
    return {"parameters": rows, "samples": belief.samples, "curves": curves(belief)}


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


class LineShown:
    """The newest race line with its corridor; `name` changes when what is drawn does."""

    def __init__(self, track: Track) -> None:
        self._track = track
        self._newest: RaceLine | None = None
        self.name = ""
        self.drawn: dict[str, Any] | None = None

    def take(self, message: RaceLine | None) -> None:
        """Take in the newest message."""
        if message is None or message is self._newest:
            return
        self._newest = message
        name = f"{zlib.crc32(repr((message.x, message.y, message.clearance_m)).encode()):08x}"
        if name == self.name:
            return
        self.name = name
        corridor = edges(self._track, message.clearance_m)
        self.drawn = {"name": name, "x": list(message.x), "y": list(message.y), "corridor": corridor}
