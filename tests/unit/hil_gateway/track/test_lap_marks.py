"""What keeps a lap from being compared: a stop, a yellow flag, a start from rest, a gap; none of them is a best lap."""

from __future__ import annotations

import pytest

from hil_gateway.track.lap_clock import LapClock, Mark

LENGTH = 3000.0


class Drive:
    """A car that is asked for positions ten times a second; `place` in m since the start of the first whole lap."""

    def __init__(self) -> None:
        self.clock, self.t_s, self.place = LapClock(LENGTH), 0.0, -200.0

    def go(self, metres: float, speed: float, *, yellow: bool = False, seen: bool = True) -> None:
        steps = round(metres / speed * 10)
        for _ in range(steps):
            self.t_s, self.place = self.t_s + 0.1, self.place + metres / steps
            if seen:
                self.clock.update(self.t_s, self.place % LENGTH, speed, yellow)

    def stand(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.t_s += 0.1
            self.clock.update(self.t_s, self.place % LENGTH, 0.0)


def test_five_minutes_of_standing_are_in_no_best_lap():
    drive = Drive()
    drive.go(200 + LENGTH + 100, 50.0)
    drive.stand(300.0)
    drive.go(2 * LENGTH, 50.0)
    first, held, last = drive.clock.laps
    assert (first.marks, held.marks, last.marks) == ((), (Mark.STOP,), ())
    assert held.stood_s == pytest.approx(300.0, abs=0.2) and held.time_s == pytest.approx(360.0, abs=0.3)
    assert drive.clock.best.time_s == pytest.approx(60.0, abs=0.1)


def test_a_lap_under_yellow_is_no_best_lap_even_if_it_is_the_quickest():
    drive = Drive()
    drive.go(200 + LENGTH + 1000, 50.0)
    drive.go(300, 50.0, yellow=True)
    drive.go(1700 + LENGTH + 10, 80.0)
    assert [lap.marks for lap in drive.clock.laps] == [(), (Mark.YELLOW,), ()]
    assert drive.clock.best is drive.clock.laps[2]


def test_the_first_lap_from_rest_is_no_best_lap():
    clock = LapClock(LENGTH)
    for i in range(1500):
        clock.update(0.1 * i, 5.0 * i % LENGTH, 0.0 if i == 0 else 50.0)
    assert clock.laps[0].marks == (Mark.FROM_REST,) and clock.laps[0].time_s < clock.laps[1].time_s + 1e-6
    assert clock.best is clock.laps[1]


@pytest.mark.parametrize(("before", "across", "marked"), [(500, 400, [1]), (2900, 400, [1, 2]), (0, 2400, [1])])
def test_laps_across_a_gap_are_there_with_the_gap_marked(before: int, across: int, marked: list[int]):
    drive = Drive()
    drive.go(200 + LENGTH + before, 50.0)
    drive.go(across, 50.0, seen=False)
    drive.go(3 * LENGTH, 50.0)
    laps = drive.clock.laps
    assert [lap.number - 1 for lap in laps if Mark.GAP in lap.marks] == marked
    assert [lap.time_s for lap in laps[:4]] == pytest.approx([60.0] * 4, abs=0.1)


def test_no_lap_is_made_of_a_gap_in_which_the_car_may_have_gone_round_more_than_once():
    drive = Drive()
    drive.go(200 + LENGTH + 500, 50.0)
    drive.go(2.2 * LENGTH, 50.0, seen=False)
    drive.go(2 * LENGTH, 50.0)
    assert [lap.marks for lap in drive.clock.laps] == [(), ()]
    assert [lap.time_s for lap in drive.clock.laps] == pytest.approx([60.0, 60.0], abs=0.1)
