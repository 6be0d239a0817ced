"""What a car did between two stands: laps and kilometres on which tyres, in which run, and what people said of it."""

from __future__ import annotations

from typing import Any

from hil_gateway.bus.track_day.note import Note
from hil_gateway.bus.track_day.run import UNDER_WAY, RunStatus
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.track.lap_clock import Lap

LONGEST_STEP_S = 1.0
"""between two positions: what lies in a gap is not counted as driven"""

DRIVEN = ("seconds", "km", "top_speed")
"""of a run, from its start until it is done or left"""


class Outing:
    """Message by message, in order of time; `t_s` in s since the recording began."""

    def __init__(self) -> None:
        self._laps: list[dict[str, Any]] = []
        self._runs: dict[int, dict[str, Any]] = {}
        self._notes: list[dict[str, Any]] = []
        self._sets: dict[str, dict[str, float]] = {}
        self._tyres = ""
        self._weather: dict[str, float] = {}
        self.run = self._newest = self._before = 0
        """number of the run the car is in, 0 in none; of the newest one; of those of planners before this one"""
        self._last_s: float | None = None
        self._metres = self._fastest = 0.0

    def moved(self, t_s: float, speed: float, lap: Lap | None) -> None:
        """The car goes with `speed` (m/s); `lap` that has just ended."""
        step_s = 0.0 if self._last_s is None else t_s - self._last_s
        metres = abs(speed) * step_s if step_s <= LONGEST_STEP_S else 0.0
        self._last_s, self._fastest, self._metres = t_s, max(self._fastest, speed), self._metres + metres
        if (run := self._runs.get(self.run)) and run["phase"] in UNDER_WAY:
            run["seconds"], run["km"] = t_s - run["t"], run["km"] + metres / 1000.0
            run["top_speed"] = max(run["top_speed"], speed)
        if abs(speed) < STANDSTILL and lap is None:
            return  # no tyres are driven on
        used = self._sets.setdefault(self._tyres, {"laps": 0, "km": 0.0})
        used["km"] += metres / 1000.0
        if lap is not None:
            used["laps"] += 1
            self._laps.append(lap.tree() | {"start_s": round(lap.start_s, 3), "run": self.run, "tyres": self._tyres})

    def take_run(self, t_s: float, status: RunStatus, parked: dict[str, float] | None = None) -> None:
        """Where in its run the car is, and how a car that has come to rest in its box stands there."""
        if status.number < self._newest - self._before:  # another planner counts from 0 again
            self._before = self._newest
            if (left := self._runs[self._newest])["phase"] in UNDER_WAY:
                left |= {"phase": "broken off", "said": "the planner was started again, and knows of no run"}
        if status.plan is None:
            self.run = 0
            return
        number = self._before + status.number
        new = number not in self._runs
        if new and status.plan.tyres:
            self._tyres = status.plan.tyres
        begun: dict[str, Any] = {"t": t_s, "speed_caps": [], "load_caps": [], "parked": None}
        begun |= dict.fromkeys(DRIVEN, 0.0)
        row = self._runs.setdefault(number, begun)
        self.run = self._newest = number
        plan = status.plan.model_dump(mode="json", include={"name", "tyres", "fuel_kg", "notes"})
        row |= {"number": number, **plan, "asked_laps": status.plan.laps, "caps_from": status.caps_from}
        row |= {"phase": status.phase.value, "clean": status.clean, "said": status.said or row.get("said", "")}
        row["parked"] = row["parked"] or parked
        for name, cap in (("speed_caps", status.speed_cap), ("load_caps", status.load_cap)):
            if cap is not None and cap not in row[name]:
                row[name].append(cap)

    def take_note(self, t_s: float, note: Note) -> None:
        """What a person says."""
        self._tyres = note.tyres or self._tyres
        self._weather |= {k: v for k, v in (("air_c", note.air_c), ("road_c", note.road_c)) if v is not None}
        said = note.model_dump(include={"text", "tyres", "air_c", "road_c"})
        self._notes.append({"t": t_s, **said})

    def tree(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "laps": self._laps,
            "best_lap_s": min((lap["time_s"] for lap in self._laps if not lap["marks"]), default=None),
            "runs": [run | {k: round(run[k], 3) for k in DRIVEN} for run in self._runs.values()],
            "remarks": self._notes, "weather": self._weather,
            "km": round(self._metres / 1000.0, 3), "top_speed": round(self._fastest, 2),
            "tyres": {name: used | {"km": round(used["km"], 3)} for name, used in self._sets.items()},
        }  # fmt: skip
