"""A stop for lateness names who was held up, for how long, the load and the remedy; by the kernel's account too."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.demo.waiting import Account, Waiting
from hil_gateway.gateway.decide.failsafe import TABLE
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.processor_wait import (
    TIMING_CAUSES,
    Load,
    ProcessorTime,
    processor_time,
    read_load,
    who_was_late,
)


@pytest.mark.parametrize(
    ("part", "cause", "words"),
    [
        ("planner_runs", "command_stale", r"^planner held up: no command for 1[0-4]0 ms; "),
        ("gateway_runs", "gateway_late", r"^gateway held up: its period did not run for 2[0-2]0 ms[,;]"),
        ("estimator_runs", "estimate_invalid", r"^estimator held up: no estimate for \d+ ms[,;]"),
    ],
)
def test_a_stop_for_lateness_names_who_was_held_up_for_how_long(part: str, cause: str, words: str) -> None:
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
    assert re.search(r"^car or plant held up: no CAN frame for [89]0 ms", rig.status.detail), rig.status.detail


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
    assert "end other programs" in Load(5.2, 1, 2).remedy
    assert "end other programs" in Load(0.4, 7, 2).remedy, "a burst is not in the mean yet"
    assert "not busy" in Load(1.2, 2, 2).remedy
    load = read_load()
    assert load.average >= 0
    assert load.ready >= 1
    assert load.processors == len(os.sched_getaffinity(0))


def test_a_process_that_really_waits_for_a_processor_is_named_by_the_kernels_account() -> None:
    """Two busy processes on one processor: the one that gives way waits; beside other programs the other may, too, and
    longer."""
    processor = min(os.sched_getaffinity(0))
    spin = f"import os, sys; os.sched_setaffinity(0, [{processor}]); os.nice(int(sys.argv[1]))\nwhile True: pass"
    pair = {
        "planner": subprocess.Popen([sys.executable, "-c", spin, "8"]),
        "plant": subprocess.Popen([sys.executable, "-c", spin, "0"]),
    }
    waiting, pids = Waiting(), {name: process.pid for name, process in pair.items()}
    try:
        while any((processor_time(pid) or ProcessorTime(0, 0)).computed_s < 0.2 for pid in pids.values()):
            time.sleep(0.01)  # both are up and share the processor
        start = time.monotonic_ns()
        waiting.stop_began(start)
        while not waiting.update(time.monotonic_ns(), pids):
            time.sleep(0.05)
    finally:
        for process in pair.values():
            process.kill()
            process.wait()
    account = waiting.account
    assert account is not None
    assert account.times["planner"].waited_s > account.times["planner"].computed_s
    waited_longest = max(account.times, key=lambda name: account.times[name].waited_s)
    assert str(account).startswith(f"{waited_longest} waited ")
    assert re.search(r"of \d+(\.\d+)? s for a processor; load \d", str(account))
    assert account.as_json()["waited_s"]["planner"] == account.times["planner"].waited_s


def test_where_nobody_waited_the_busiest_is_named() -> None:
    times = {"planner": ProcessorTime(1.2, 0.01), "plant": ProcessorTime(0.3, 0.02)}
    assert str(Account(2.0, times, "-")) == "no process waited for a processor; planner computed 1.2 s of 2 s"


def test_without_a_stop_there_is_no_account() -> None:
    waiting = Waiting()
    for period in range(100):
        assert not waiting.update(period * NS_PER_S // 20, {"self": os.getpid()})
    waiting.close()
    assert waiting.account is None
