"""The verdict on a loss: by what the car did, not by what was expected of the machine."""

from __future__ import annotations

import random
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.driving.soak import Loss, losses, trial
from hil_gateway.bus.messages import FailsafeAction


class Loop:
    """A car that drives at 30 m/s until something happens to it."""

    def __init__(self, *, drives_again: bool = True) -> None:
        self.referee = SimpleNamespace(off_track=0, speed=30.0)
        self.judge = SimpleNamespace(faults=[])
        self.action, self.cause, self.missing = FailsafeAction.DRIVE, "", "estimate_old"
        self.drives_again, self.gone = drives_again, []

    def look(self, _: float = 0.0) -> None: ...

    def start_missing(self) -> None: ...

    def bring_back(self) -> None: ...

    def died(self) -> list[str]:
        return self.gone

    def drives_off(self, _: float) -> bool:
        return self.drives_again


def stopped(cause: str, **changes: object):
    def happen(loop: Loop, _: random.Random) -> None:
        loop.action, loop.cause, loop.referee.speed = FailsafeAction.CONTROLLED_STOP, cause, 0.0
        for name, value in changes.items():
            setattr(loop, name, value)

    return happen


def off_the_road(loop: Loop, _: random.Random) -> None:
    stopped("command_dead")(loop, _)
    loop.referee.off_track = 1


@pytest.mark.parametrize(
    ("loss", "loop", "broken"),
    [
        (Loss("planner kill", stopped("command_dead"), stops=True), Loop(), ""),
        (Loss("planner kill", lambda *_: None, stops=True), Loop(), "drives on, against docs/failsafe.md"),
        (Loss("recorder kill", stopped("position_wrong"), stops=False), Loop(), "stops, against docs/failsafe.md"),
        (Loss("recorder kill", stopped("gateway_late"), stops=False), Loop(), ""),
        (Loss("planner kill", off_the_road, stops=True), Loop(), "left the road"),
        (Loss("gateway kill", off_the_road, stops=True, own_brakes=True), Loop(), ""),
        (Loss("planner kill", stopped("x"), stops=True), Loop(drives_again=False), "missing for arming: estimate_old"),
        (Loss("planner kill", stopped("x", gone=["it ended"]), stops=True), Loop(), "died with it: it ended"),
    ],
)  # fmt: skip
def test_a_loss_is_kept_where_the_car_does_what_is_stated(loss: Loss, loop: Loop, broken: str) -> None:
    assert trial(loop, loss, "driving", random.Random(0)).broken == broken


def test_a_disk_is_filled_only_where_it_is_small_and_the_clock_is_set_only_when_asked(
    tmp_path: Path, monkeypatch
) -> None:
    names = lambda clock: {loss.name for loss in losses(tmp_path, clock)}  # noqa: E731
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(total=1e12, free=1e11))
    large = names(False)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(total=1e8, free=1e7))
    assert names(False) - large == {"disk full"}
    assert names(True) - names(False) == {"clock stepped"}
    assert len({name for name in large if name.startswith("gateway")}) == 3
