"""Driving off: which reference a plan follows from where the car stands, and whether it sets the car going."""

from __future__ import annotations

from hil_gateway.bus.messages import Applied, FailsafeAction
from hil_gateway.gateway.decide.arming import UNDER_WAY_S
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from planner.line.joining import Joined, Joining, Pose, offset_and_angle
from planner.line.pit_route import PitRoute, PitRoutes
from planner.line.track import Reference
from planner.problem.motion import VX

WALKING = 3.0
"""m/s up to which a car gets a way of its own onto the race line; a faster one is led there by its controller"""
STILL = 0.1
"""m/s up to which a car is not under way: a few times the noise of an estimate at rest"""
OFF = 0.1, 0.02
"""m and rad beside its reference within which a standing car needs no other: what fixes leave"""
PATIENCE_NS = 2 * NS_PER_S


class Following:
    """The race line or the way through the pit lane, or the way from where the car stood onto one of them."""

    def __init__(self, joining: Joining, lane: PitRoutes | None) -> None:
        self._joining, self._lane = joining, lane
        self._joined: Joined | None = None
        self._route: PitRoute | None = None
        self.hindrance = ""
        """why there is no way from where the car stands, in words; empty where there is one"""

    def path(self, race_line: Reference, s: float, in_lane: bool, coming: PitRoute | None) -> Reference:
        """The race line, unless a car at progress `s` is `in_lane` alone, is `coming` in, or is not yet out again."""
        joining = self._joined is not None and not self._joined.ended(s)
        if not (joining or (self._route is not None and self._route.holds(s))):
            self._route = self._route_from(race_line, s, in_lane, coming)
        if self._route is None or self._lane is None:
            return race_line
        if self._route.base is not race_line:
            self._route = self._lane.again(self._route, race_line)
        return self._route.reference

    def _route_from(
        self, race_line: Reference, s: float, in_lane: bool, coming: PitRoute | None
    ) -> PitRoute | None:  # fmt: skip
        """Through the pit lane from progress `s` on; None where the way is the race line."""
        if coming is not None and not coming.holds(s):
            return self._route if self._route is not None and self._route.way is coming.way else coming
        if not in_lane or self._lane is None:
            return None
        found = self._lane.through(race_line, None)
        self.hindrance = found if isinstance(found, str) else ""
        return None if isinstance(found, str) else found

    def reference(self, base: Reference, s: float) -> Reference:
        """What a car at progress `s` follows; `base` is the race line with its newest speeds."""
        if self._joined is not None and self._joined.ended(s):
            self._joined = None
        if self._joined is not None and self._joined.base is not base:
            self._joined = self._joining.again(self._joined, base)
        return base if self._joined is None else self._joined.reference

    def begin(self, base: Reference, pose: Pose, steer: float) -> None:
        """Follow a way from `pose` on, with the wheels turned by `steer` (rad)."""
        found = self._joining.join(base, pose, steer)
        self._joined, self.hindrance = (None, found) if isinstance(found, str) else (found, "")

    def give_up(self) -> None:
        """The car is where no way of before leads from."""
        self._joined, self._route, self.hindrance = None, None, ""


def is_off(reference: Reference, s: float, pose: Pose) -> bool:
    """Whether a pose is not on a reference at progress `s`."""
    offset, across = offset_and_angle(reference, s, pose)
    return abs(offset) > OFF[0] or abs(across) > OFF[1]


def moves_off(z: Array, dt: float) -> bool:
    """Whether states (NZ, N+1) at steps of `dt` (s) begin to move."""
    return bool(z[VX, : round(UNDER_WAY_S / dt) + 1].max() > STANDSTILL)


class Unmoved:
    """Why a car does not move although it is driven; `update` once a plan."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def forget(self) -> None:
        """The plan itself stands."""
        self._since_ns = None

    def update(self, now_ns: int, applied: Applied | None, speed: float) -> str:
        """In words; empty while the car moves, is not driven, or has not had `PATIENCE_NS`."""
        driven = applied is not None and applied.sent and applied.action is FailsafeAction.DRIVE
        if applied is None or not driven or speed > STANDSTILL:
            self._since_ns = None
            return ""
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        if now_ns - self._since_ns < PATIENCE_NS:
            return ""
        waited_s, asked = (now_ns - self._since_ns) / NS_PER_S, applied.accelerator_percent
        return f"driven with {asked:.0f} % of accelerator in gear {applied.gear} for {waited_s:.0f} s: brakes, clutch?"
