"""A stop for lateness names who was late, which may have ended, for how long, the load and the remedy."""

from __future__ import annotations

import os
import re

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.gateway.decide.failsafe import TABLE
from hil_gateway.process.processor_wait import (
    TIMING_CAUSES,
    Load,
    read_load,
    who_was_late,
)


@pytest.mark.parametrize(
    ("part", "cause", "words"),
    [
        ("planner_runs", "command_stale", r"^planner late: no command for 1[0-4]0 ms; "),
        ("gateway_runs", "gateway_late", r"^gateway late: its period did not run for 2[0-2]0 ms[,;]"),
        ("estimator_runs", "estimate_invalid", r"^estimator late: no estimate for \d+ ms[,;]"),
    ],
)
def test_a_stop_for_lateness_names_who_was_late_for_how_long(part: str, cause: str, words: str) -> None:
    rig = Rig()
    rig.gateway._reporter._load = lambda: "load 5, 7 tasks ready on 2 processors: end other programs"
    rig.drive_off()
    assert rig.status is not None
    assert rig.status.detail == ""
    setattr(rig, part, False)
    rig.run(0.2)
    setattr(rig, part, True)
    rig.run(0.2)
    assert rig.cause == cause
    assert re.search(words, rig.status.detail), rig.status.detail
    assert "load 5, 7 tasks ready on 2 processors: end other programs" in rig.status.detail


def test_a_car_held_up_for_90_ms_is_named_although_it_speaks_again_when_the_stop_begins() -> None:
    rig = Rig()
    rig.drive_off()
    rig.car.reports = False
    rig.run(0.05)
    rig.estimate_valid = False  # a filter whose input is too old
    rig.run(0.04)
    rig.car.reports = True
    rig.run(0.2)
    assert rig.cause == "estimate_invalid"
    assert rig.status is not None
    assert re.search(r"^car or plant late: no CAN frame for [89]0 ms", rig.status.detail), rig.status.detail


def test_a_stop_for_another_reason_says_nothing_of_lateness() -> None:
    rig = Rig()
    rig.drive_off()
    rig.ask(OperatorAction.STOP)
    rig.run(0.3)
    assert rig.action is FailsafeAction.CONTROLLED_STOP
    assert rig.status is not None
    assert rig.status.detail == ""


def test_every_cause_of_lateness_is_a_row_of_the_table_and_absence_is_not_lateness() -> None:
    assert {row.cause for row in TABLE} >= TIMING_CAUSES
    assert who_was_late("command_stale", {"command_age": float("inf")}) == ""


def test_the_remedy_depends_on_whether_the_computer_is_busy() -> None:
    assert "if it runs, end other programs" in Load(5.2, 1, 2).remedy
    assert "if it runs, end other programs" in Load(0.4, 7, 2).remedy, "a burst is not in the mean yet"
    assert "not busy" in Load(1.2, 2, 2).remedy
    load = read_load()
    assert load.average >= 0
    assert load.ready >= 1
    assert load.processors == len(os.sched_getaffinity(0))
