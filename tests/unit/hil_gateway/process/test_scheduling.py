"""Being on time: real-time priority where it is permitted, what is left otherwise."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

ROOT_ONLY = pytest.mark.skipif(os.geteuid() != 0, reason="only root may ask for real-time priority")
ASK = (
    "import os, resource, threading;"
    "from hil_gateway.process.scheduling import punctual;"
    "{first};"
    "threading.Thread(target=threading.Event().wait, daemon=True).start();"
    "policy = lambda task: os.sched_getscheduler(int(task)) & ~os.SCHED_RESET_ON_FORK;"
    "print(punctual(), *map(policy, os.listdir('/proc/self/task')), open('/proc/self/timerslack_ns').read())"
)
"""the answer, the policy of the main and of a second thread, and the slack of timers, ns"""


def asked(first: str) -> list[str]:
    command = [sys.executable, "-c", ASK.format(first=first)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


@ROOT_ONLY
def test_every_thread_gets_real_time_priority_where_it_is_permitted() -> None:
    assert asked("pass")[:3] == ["True", str(os.SCHED_RR), str(os.SCHED_RR)]


@ROOT_ONLY
def test_a_real_time_policy_given_by_somebody_else_is_kept() -> None:
    given = asked("os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(80))")
    assert given[:3] == ["True", str(os.SCHED_FIFO), str(os.SCHED_FIFO)]


def test_without_permission_timers_are_exact_and_the_policy_is_the_usual_one() -> None:
    first = "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0)); os.geteuid() or os.setuid(65534)"
    assert asked(first) == ["False", str(os.SCHED_OTHER), str(os.SCHED_OTHER), "1"]
