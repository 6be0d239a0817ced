"""Where in its run a car is, where it stops, and what a run leaves for the next one."""

from __future__ import annotations

import pytest

from hil_gateway.bus.track_day.run import RunAction, RunPhase, RunPlan, RunRequest, read_run
from hil_gateway.process.errors import InputError
from hil_gateway.settings.gateway import CAUTION_DECELERATION
from planner.run.expansion import FIRST, FREE, Caps, Expansion
from planner.run.progress import Progress

LENGTH, PLACE, BRAKES = 3000.0, 2970.0, 6.0


class Drive:
    """A car at 40 m/s that brakes as it is to, and stands when it is told why."""

    def __init__(self, expansion: Expansion | None = None, **given: bool) -> None:
        self.run = Progress(LENGTH, "car model", expansion or Expansion(), **given)
        self.s, self.speed, self.asked = -30.0, 0.0, 0

    def ask(self, action: RunAction, plan: RunPlan | None = None) -> None:
        self.asked += 1
        request = RunRequest(stamp_ns=1, seq=self.asked, source="t", action=action, plan=plan)
        self.run.ask(request, self.s, PLACE)

    def go(self, seconds: float) -> list[tuple[RunPhase, int]]:
        """Phases and laps in the order in which they came."""
        seen = []
        for _ in range(round(20 * seconds)):
            self.run.advance(self.s, self.speed)
            halts = self.run.halts(self.s, self.speed, BRAKES)
            ahead = (self.run.stop_s or 1e9) - self.s
            most = min(40.0, (2 * CAUTION_DECELERATION * max(ahead, 0.0)) ** 0.5 + 1.0)
            self.speed = max(self.speed - 0.05 * BRAKES, 0.0) if halts else min(self.speed + 0.3, most)
            self.s += 0.05 * self.speed
            if not seen or seen[-1] != (self.run.phase, self.run.lap):
                seen.append((self.run.phase, self.run.lap))
        return seen


def test_a_run_is_out_lap_flying_laps_and_in_lap_to_its_place():
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=2))
    assert drive.go(400.0) == [
        (RunPhase.OUT_LAP, 0), (RunPhase.FLYING, 1), (RunPhase.FLYING, 2), (RunPhase.IN_LAP, 3), (RunPhase.DONE, 3),
    ]  # fmt: skip
    assert drive.s == pytest.approx(3 * LENGTH + PLACE, abs=2.0) and drive.speed == 0.0
    assert drive.run.clean and "hil run next" in drive.run.halts(drive.s, 0.0, BRAKES)


def test_an_in_lap_that_is_asked_for_too_late_ends_a_lap_later():
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=50))
    while drive.s < LENGTH + PLACE - 100.0:  # 40 m/s take 267 m at 3 m/s2
        drive.go(0.05)
    drive.ask(RunAction.IN)
    assert drive.run.phase is RunPhase.IN_LAP
    drive.go(150.0)
    assert drive.s == pytest.approx(2 * LENGTH + PLACE, abs=2.0) and drive.run.phase is RunPhase.DONE


def test_only_clean_runs_raise_the_caps_and_each_says_why(tmp_path):
    file = str(tmp_path / "new folder" / "caps.json")
    drive = Drive(Expansion(file))
    drive.ask(RunAction.START, RunPlan(laps=1))
    assert drive.run.caps == FIRST and "have not driven" in drive.run.caps_from
    drive.go(300.0)
    drive.ask(RunAction.NEXT)
    second = drive.run.caps
    assert second == FIRST.raised() and "clean runs" in drive.run.caps_from
    drive.run.note("the car slid")
    drive.go(300.0)
    assert drive.run.clean is False and "the car slid" in drive.run.said
    drive.ask(RunAction.NEXT)
    assert drive.run.caps == second
    drive.go(20.0)
    drive.ask(RunAction.ABORT)
    drive.go(20.0)
    assert (drive.run.phase, drive.run.clean, drive.speed) == (RunPhase.DONE, False, 0.0)
    assert Expansion(file).caps("car model")[0] == second and Expansion(file).caps("car other model")[0] == FIRST


def test_caps_that_cannot_be_kept_are_said_and_end_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    drive = Drive(Expansion(str(tmp_path / "file" / "caps.json")))
    drive.ask(RunAction.START, RunPlan(laps=1))
    drive.go(300.0)
    assert drive.run.clean and "not kept for the next start" in drive.run.said
    drive.ask(RunAction.NEXT)
    assert drive.run.caps == FIRST.raised()


def test_caps_of_the_plan_hold_lap_by_lap():
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=4, speed=(20.0, 25.0), load_use=(0.4, 0.6, 0.8)))
    found = {}
    for _ in range(8000):
        drive.go(0.05)
        found[drive.run.phase, drive.run.lap] = drive.run.caps
    assert [found[RunPhase.FLYING, lap] for lap in (1, 2, 3, 4)] == [
        Caps(20.0, 0.4), Caps(25.0, 0.6), Caps(25.0, 0.8), Caps(25.0, 0.8),
    ]  # fmt: skip


def test_without_a_run_nothing_is_capped_unless_that_is_configured():
    assert Drive().run.caps == FREE
    assert Drive(without_run=True).run.caps == FIRST


def test_what_cannot_be_asked_for_is_refused_in_words():
    drive = Drive()
    for action in (RunAction.IN, RunAction.NEXT):
        drive.ask(action)
        assert drive.run.refused and drive.run.phase is RunPhase.NONE
    drive.ask(RunAction.START, RunPlan())
    drive.ask(RunAction.START, RunPlan(laps=7))
    assert drive.run.refused and drive.run.plan == RunPlan() and drive.run.said == "run 1 begins"
    drive.ask(RunAction.IN)
    assert not drive.run.refused and drive.run.said == "in lap, as asked"


def test_who_gives_up_a_run_that_a_new_planner_knows_nothing_of_is_not_refused():
    drive = Drive()
    drive.ask(RunAction.NEXT)
    drive.ask(RunAction.ABORT)
    assert not drive.run.refused and drive.run.phase is RunPhase.NONE
    assert drive.run.said == "what a planner before this one began is given up; `hil gateway stop` stops the car"


def test_a_run_file_is_read_or_refused_with_key_and_value(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text('laps = 3\nspeed = [30, 40]\ntyres = "A1"\nfuel_kg = 40\nnotes = "front wing +1"\n')
    assert read_run(path) == RunPlan(laps=3, speed=(30.0, 40.0), tyres="A1", fuel_kg=40.0, notes="front wing +1")
    for text, said in (
        ("lap = 3", "unknown key lap"),
        ("laps = 0", "laps = 0"),
        ("load_use = [1.2]", "load_use.0 = 1.2"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=said):
            read_run(path)


def test_the_car_comes_in_while_its_fuel_lasts_and_before_its_tyres_are_too_hot():
    drive = Drive()
    drive.ask(RunAction.START, RunPlan(laps=50, fuel_kg=7.5, fuel_per_km=0.5))  # 15 km: five laps
    drive.go(600.0)
    assert drive.run.phase is RunPhase.DONE and "fuel" not in drive.run.said
    assert 3 * LENGTH < drive.s < 5 * LENGTH
    drive.ask(RunAction.START, RunPlan(laps=50, tyre_c_max=110.0))
    drive.go(30.0)
    drive.run.heat(110.0)
    assert drive.run.phase is RunPhase.OUT_LAP
    drive.run.heat(111.0)
    assert drive.run.phase is RunPhase.IN_LAP and drive.run.said == "in lap: a tyre has 111 deg C"


def test_consumption_without_fuel_is_refused(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("fuel_per_km = 0.5")
    with pytest.raises(InputError, match="says nothing without fuel_kg"):
        read_run(path)
