"""Where in its run the car is, what holds there, and where it has to stop. Pure: time and place are arguments."""

from __future__ import annotations

from dataclasses import dataclass, field

from hil_gateway.bus.track_day.run import UNDER_WAY, RunAction, RunPhase, RunPlan, RunRequest, cap_of
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.settings.gateway import CAUTION_DECELERATION
from planner.run.expansion import FREE, Caps, Expansion

CREEP, CREEP_M = 1.5, 2.0
"""m/s with which the car comes up to where it stops: walking pace, from which it stops within 0.5 m; and the way, m,
on which it does: what a plan is behind its speed limit while it brakes"""
REACTION_S = 0.15
"""from the plan that stops to brakes that bite: latency of the loop, and the rise of the pressure"""
NEAR_M = 5.0
"""a car that stands this close to its place has reached it"""


@dataclass
class Progress:
    """One run after the other on a lap of `length` m; `key` names car and model."""

    length: float
    key: str
    expansion: Expansion
    without_run: bool = False
    """the caps of a first run hold where nobody has started one, too"""
    phase: RunPhase = RunPhase.NONE
    number: int = 0
    plan: RunPlan | None = None
    lap: int = 0
    caps_from: str = ""
    said: str = ""
    refused: str = ""
    """why the last request came to nothing"""
    stop_s: float | None = None
    """progress at which the car is to stop, m"""
    clean: bool | None = None
    _base: Caps = FREE
    _aborted: bool = False
    _from: float = 0.0
    """progress at which the run began, m"""
    _line: float = 0.0
    """progress at which the lap under way ends"""
    _place: float = 0.0
    """where the in lap ends, m along the race line"""
    _way_in: float = 0.0
    """m before it from which on the way there is not the race line"""
    _driven: list[Caps] = field(default_factory=list)
    _unclean: list[str] = field(default_factory=list)

    @property
    def caps(self) -> Caps:
        """What holds now."""
        if self.plan is None or self.phase is RunPhase.NONE:
            return self.expansion.caps(self.key)[0] if self.without_run else FREE
        lap = max(self.lap - 1, 0)
        return Caps(
            cap_of(self.plan.speed, lap, self._base.speed), cap_of(self.plan.load_use, lap, self._base.load_use)
        )

    def ask(self, request: RunRequest, s: float, place: float, way_in: float = 0.0) -> bool:
        """A person's request with the car at progress `s`: whether a run begins. `place` is where its in lap will end,
        m along the line, on a way that parts from the race line `way_in` (m) before it."""
        under_way, self.refused = self.phase in UNDER_WAY, ""
        if request.action in (RunAction.START, RunAction.NEXT):
            plan = request.plan or self.plan
            if under_way:
                self.refused = f"run {self.number} is under way: first `hil run in` or `hil run abort`"
            elif plan is None:
                self.refused = "there is no run to go on with: `hil run start run.toml`"
            else:
                self._place, self._way_in = place, way_in
                self._start(plan, s)
                return True
        elif request.action is RunAction.ABORT and self.phase is RunPhase.NONE:
            self.said = "what a planner before this one began is given up; `hil gateway stop` stops the car"
        elif not under_way:
            self.refused = "no run is under way"
        elif request.action is RunAction.IN:
            self.come_in("in lap, as asked")
        else:
            self._aborted, self.phase, self.said = True, RunPhase.IN_LAP, "aborted: stops here"
            self._unclean.append("aborted")
        return False

    def come_in(self, why: str) -> None:
        """The lap under way becomes the in lap, if it is not."""
        if self.phase in (RunPhase.OUT_LAP, RunPhase.FLYING):
            self.phase, self.said = RunPhase.IN_LAP, why

    def _start(self, plan: RunPlan, s: float) -> None:
        self._base, why = self.expansion.caps(self.key)
        given = [name for name, caps in (("speed", plan.speed), ("load_use", plan.load_use)) if caps]
        self.caps_from = f"{' and '.join(given)} from the run plan" if given else ""
        self.caps_from += f"{'; ' if given else ''}{why}" if len(given) < 2 else ""
        self.plan, self.number, self.lap = plan, self.number + 1, 0
        self.stop_s, self._aborted, self._unclean, self._driven, self.clean = None, False, [], [], None
        self.phase = RunPhase.OUT_LAP if plan.out_lap else RunPhase.FLYING
        self.lap = 0 if plan.out_lap else 1
        self._from = s
        self._line = self.length * round(s / self.length + 1.0)  # a line close ahead ends no lap
        self.said = f"run {self.number} begins"

    def note(self, why: str) -> None:
        """Something that makes the run under way not clean."""
        if self.phase in UNDER_WAY and why not in self._unclean:
            self._unclean.append(why)

    def advance(self, s: float, speed: float) -> None:
        """The car is at progress `s` with `speed` (m/s)."""
        if self.phase not in UNDER_WAY:
            return
        if self.caps not in self._driven:
            self._driven.append(self.caps)
        if self.phase is not RunPhase.IN_LAP and s >= self._line:
            self._line += self.length
            self.lap += 1
            done = self.plan is not None and self.lap > self.plan.laps
            self.phase = RunPhase.IN_LAP if done else RunPhase.FLYING
            self.said = "in lap: the laps of the run are done" if done else ""
        if self._fuel_is_low(s):
            self.come_in("in lap: fuel for two laps is left")
        if self.phase is RunPhase.IN_LAP and not self._aborted and self.stop_s is None:
            way = speed**2 / (2.0 * CAUTION_DECELERATION) + max(NEAR_M, self._way_in)
            self.stop_s = s + way + (self._place - s - way) % self.length
        if self.phase is RunPhase.IN_LAP and speed < STANDSTILL and self._there(s):
            self._finish()

    def _fuel_is_low(self, s: float) -> bool:
        """Two laps: the in lap ends within the next one, or one later where its place is too near."""
        plan = self.plan
        if plan is None or plan.fuel_kg is None or plan.fuel_per_km is None:
            return False
        return plan.fuel_kg < plan.fuel_per_km * (s - self._from + 2.0 * self.length) / 1000.0

    def heat(self, hottest_c: float) -> None:
        """Temperature of the hottest point of the tyres, deg C."""
        if self.plan is not None and self.plan.tyre_c_max is not None and hottest_c > self.plan.tyre_c_max:
            self.come_in(f"in lap: a tyre has {hottest_c:.0f} deg C")

    def _there(self, s: float) -> bool:
        return self._aborted or (self.stop_s is not None and s > self.stop_s - NEAR_M)

    def _finish(self) -> None:
        self.phase, self.clean = RunPhase.DONE, not self._unclean
        if self.clean:
            most = Caps(max(c.speed for c in self._driven), max(c.load_use for c in self._driven))
            self.said = f"stopped; {self.expansion.clean_run(self.key, most)}"
        else:
            self.said = f"stopped; not clean, caps stay: {'; '.join(self._unclean)}"

    def halts(self, s: float, speed: float, deceleration: float) -> str:
        """Why the car has to brake or stand now, in words; empty where it may go on.

        `deceleration` (m/s2) is what the stop that follows brakes with.
        """
        if self.phase is RunPhase.DONE:
            return f"run {self.number} is done: `hil run next`, or `hil run start run.toml`"
        if self._aborted and self.phase is RunPhase.IN_LAP:
            return "the run is aborted"
        needed = speed**2 / (2.0 * deceleration) + REACTION_S * speed
        if self.stop_s is not None and self.phase is RunPhase.IN_LAP and s + needed >= self.stop_s:
            return "in lap: stops at its place"
        return ""
