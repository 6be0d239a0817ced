"""Runs of a planner: requests in, status out, and the reference with its speeds capped."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.bus.track_day.race_control import MOST_SPEED
from hil_gateway.bus.track_day.run import RunAction, RunPhase, RunPlan, RunRequest, RunStatus
from hil_gateway.car.states import VehicleFlag
from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import CAUTION_DECELERATION
from hil_gateway.track.track import Track
from planner.line.pit_route import PitRoute, PitRoutes
from planner.line.raceline import OptimisedLine
from planner.line.track import Reference
from planner.run.expansion import Caps
from planner.run.progress import CREEP, CREEP_M, Progress

BEFORE_LINE_M = 30.0
"""where the in lap ends if nobody says otherwise: on the start straight, so far before the line"""
SHOWN_AHEAD = 0.9
"""of a lap: a place that is farther ahead lies just before the car, too, where nothing is to be braked for yet"""
STOPS = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)


@dataclass(frozen=True)
class Place:
    """Where an in lap ends: m along the track, progress `s` along the race line; in a box by a `route`, or on the
    road."""

    at: float
    s: float = 0.0
    box: int | None = None
    route: PitRoute | None = None


class RunDesk:
    """What the planner asks each time; `step` once a plan, before it."""

    def __init__(self, bus: Bus, progress: Progress, track: Track, lane: PitRoutes | None) -> None:
        self._bus, self.progress, self._track, self._lane = bus, progress, track, lane
        self._requests = bus.subscribe(topics.RUN_REQUEST, depth=16)
        self._gateway = LatestReader(bus, topics.GATEWAY_STATUS)
        self._state = LatestReader(bus, topics.VEHICLE_STATE)
        self._tyres = LatestReader(bus, topics.TYRES)
        self._answered = ""
        self._known: set[tuple[str, int]] = set()
        self._due_ns, self._seq, self._slides = 0, 0, 0
        self._made: tuple[Reference, float, float | None, Reference] | None = None
        """base, cap, place and what was made of them"""
        self._end, self._in_lane = Place(0.0), False

    def step(self, now_ns: int, s: float, base: Reference) -> None:
        """Take requests in, with the car at progress `s` (m), and say where the run is."""
        asked = {(r.source, r.seq): r for r in self._requests.poll(now_ns)}  # sent again until it is answered
        news = [request for key, request in asked.items() if key not in self._known]
        self._known |= asked.keys()
        for request in news:
            self._answered = request.source
            self._ask(request, s, base, now_ns)
        if self._black(now_ns):
            self.progress.come_in("in lap: black flag")
        self.progress.heat(self._hottest(now_ns))
        status = self._gateway.update(now_ns).message
        if status is not None and status.action in STOPS:
            self.progress.note(f"stopped by the gateway: {status.cause}")
        if news or now_ns >= self._due_ns:
            self._due_ns, self._seq = now_ns + topics.RUN.period_ns, self._seq + 1
            self._bus.publish(topics.RUN, self._status(now_ns))

    def _black(self, now_ns: int) -> bool:
        state = self._state.update(now_ns).message
        return state is not None and state.vehicle_flag == VehicleFlag.BLACK

    def _hottest(self, now_ns: int) -> float:
        """Of what the tyres report, deg C; -inf while they report nothing."""
        tyres = self._tyres.update(now_ns)
        points = tyres.message.hottest if tyres.message is not None and tyres.alive(now_ns) else ()
        return max((point for point in points if point is not None), default=-np.inf)

    def _ask(self, request: RunRequest, s: float, base: Reference, now_ns: int) -> None:
        if request.action in (RunAction.START, RunAction.NEXT) and self._black(now_ns):
            self.progress.refused = "black flag of race control"
            return
        end = self._ends(request.plan or self.progress.plan, base)
        if isinstance(end, str):
            self.progress.refused = end
        elif self.progress.ask(request, s, end.s, 0.0 if end.route is None else end.route.way_in):
            self._end = end

    def slid(self, slides: int) -> None:
        """How often the car has slid so far."""
        if slides > self._slides:
            self.progress.note("the car slid")
        self._slides = slides

    def reference(self, base: Reference, s: float) -> Reference:
        """`base` with speeds that the caps allow, and that come down to where the car is to stop."""
        cap, stop_s = self.progress.caps.speed, self.progress.stop_s
        if self.progress.phase is not RunPhase.IN_LAP or (stop_s or s) - s > SHOWN_AHEAD * base.length:
            stop_s = None
        if cap >= MOST_SPEED and stop_s is None:
            return base
        if self._made is None or self._made[0] is not base or self._made[1:3] != (cap, stop_s):
            line = replace(base.line, vx_profile=capped(base.line, cap, stop_s))
            self._made = base, cap, stop_s, Reference(line, base)
        return self._made[3]

    def in_lane(self, x: float, y: float) -> bool:
        """Whether a car at a place (m) is in the pit lane alone."""
        self._in_lane = self._lane is not None and self._track.in_lane(*self._track.project(x, y))
        return self._in_lane

    def coming(self, s: float, lap: float) -> PitRoute | None:
        """The way into the box for a car at progress `s` that is to come in within this `lap` (m)."""
        stop_s = self.progress.stop_s
        comes = self.progress.phase is RunPhase.IN_LAP and stop_s is not None and stop_s - s <= SHOWN_AHEAD * lap
        return self._end.route if comes else None

    def _ends(self, plan: RunPlan | None, base: Reference) -> Place | str:
        """Where the in lap of a run ends, or why it cannot, in words."""
        boxes = () if self._track.pit_lane is None else self._track.pit_lane.boxes
        at, number = (None, None) if plan is None else (plan.stop_at, plan.box)
        if at is not None or (number is None and not boxes):
            at = (self._track.length - BEFORE_LINE_M if at is None else at) % self._track.length
            return Place(at, _on_line(base.line, at, self._track.length))
        number = number or 1
        if self._lane is None or number > len(boxes):
            return f"there is no box {number}: the pit lane of {self._track.name} has {len(boxes)}"
        route = self._lane.through(base, boxes[number - 1])
        if isinstance(route, str):
            return route
        return Place(boxes[number - 1].s % self._track.length, route.place, number, route)

    def _status(self, now_ns: int) -> RunStatus:
        p, caps = self.progress, self.progress.caps
        return RunStatus(
            stamp_ns=now_ns, seq=self._seq, phase=p.phase, number=p.number, plan=p.plan, lap=p.lap,
            **_said(caps), caps_from=p.caps_from, answered=self._answered, clean=p.clean, said=p.said,
            refused=p.refused, stop_at=None if p.plan is None else self._end.at, box=self._end.box,
            in_pit_lane=self._in_lane,
        )  # fmt: skip


def _on_line(line: OptimisedLine, at: float, length: float) -> float:
    """Metres along the race line of a place along a track of `length` m."""
    off = (line.track_s - at + 0.5 * length) % length - 0.5 * length
    return float(line.s[np.abs(off).argmin()])


def _said(caps: Caps) -> dict[str, float | None]:
    return {
        "speed_cap": caps.speed if caps.speed < MOST_SPEED else None,
        "load_cap": caps.load_use if caps.load_use < 1.0 else None,
    }


def capped(line: OptimisedLine, cap: float, stop_s: float | None) -> Array:
    """Speeds of a line, m/s, under a cap, braked gently towards progress `stop_s` (m)."""
    speeds: Array = np.minimum(line.vx_profile, cap)
    if stop_s is not None:
        ahead = (stop_s - line.s) % line.length
        ahead[ahead > SHOWN_AHEAD * line.length] = 0.0  # behind the place: no plan may see an end of the braking
        speeds = np.minimum(speeds, np.sqrt(CREEP**2 + 2.0 * CAUTION_DECELERATION * np.maximum(ahead - CREEP_M, 0.0)))
    return speeds
