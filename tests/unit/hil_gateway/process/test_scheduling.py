"""Being on time: real-time priority where it is permitted, what is left otherwise."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil_gateway.process.scheduling import PRIORITIES

ROOT_ONLY = pytest.mark.skipif(os.geteuid() != 0, reason="only root may ask for real-time priority")
ASK = (
    "import os, resource, threading;"
    "from hil_gateway.process.scheduling import punctual;"
    "{first};"
    "threading.Thread(target=threading.Event().wait, daemon=True).start();"
    "policy = lambda task: os.sched_getscheduler(int(task)) & ~os.SCHED_RESET_ON_FORK;"
    "print(punctual('planner'), *map(policy, os.listdir('/proc/self/task')), open('/proc/self/timerslack_ns').read())"
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


@ROOT_ONLY
def test_the_gateway_comes_before_the_planner() -> None:
    """Priorities as the kernel has them after each process has asked."""
    ask = "import os, sys; from hil_gateway.process.scheduling import punctual; punctual(sys.argv[1]);"
    ask += "print(os.sched_getparam(0).sched_priority)"
    found = {
        name: int(subprocess.run([sys.executable, "-c", ask, name], capture_output=True, text=True, check=True).stdout)
        for name in ("gateway", "estimator", "planner")
    }
    assert found["gateway"] > found["estimator"] > found["planner"] > 0


@pytest.mark.parametrize("first", ["pass", "os.geteuid() or os.setuid(65534)"])
def test_what_is_said_to_be_permitted_is_what_the_kernel_permits(first: str) -> None:
    """As this user, and as one without its rights."""
    ask = f"import os; from hil_gateway.process.scheduling import permitted, punctual; {first};"
    ask += "print(permitted('gateway'), punctual('gateway'))"
    said, done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True).stdout.split()
    assert said == done


@ROOT_ONLY
@pytest.mark.slow
@pytest.mark.parametrize("name", ["plant", "estimator"])
def test_a_process_started_by_hand_takes_its_priority(name: str) -> None:
    """By the kernel's account of `hil NAME run`."""
    with subprocess.Popen([sys.executable, "-m", "hil_gateway", name, "run"], stderr=subprocess.DEVNULL) as process:
        try:
            deadline, priority = time.monotonic() + 30, 0
            while not priority and time.monotonic() < deadline and process.poll() is None:
                time.sleep(0.1)
                priority = os.sched_getparam(process.pid).sched_priority
        finally:
            process.terminate()
    assert priority == PRIORITIES[name]


def test_units_and_processes_that_ask_for_themselves_have_the_same_priorities() -> None:
    units = Path(__file__).resolve().parents[4] / "deploy" / "systemd"
    stated = {
        unit.stem.removeprefix("hil-"): int(found[1])
        for unit in units.glob("*.service")
        if (found := re.search(r"^CPUSchedulingPriority=(\d+)$", unit.read_text(), re.MULTILINE))
    }
    assert stated == {name: PRIORITIES[name] for name in ("gateway", "receiver", "estimator", "planner")}


def test_without_permission_timers_are_exact_and_the_policy_is_the_usual_one() -> None:
    first = "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0)); os.geteuid() or os.setuid(65534)"
    assert asked(first) == ["False", str(os.SCHED_OTHER), str(os.SCHED_OTHER), "1"]


@pytest.mark.skipif(
    not Path("/sys/kernel/mm/transparent_hugepage/enabled").exists()
    or tuple(map(int, re.findall(r"\d+", os.uname().release)[:2])) < (6, 1),
    reason="this kernel puts no memory into large pages when asked",
)
def test_memory_is_in_large_pages_where_the_kernel_can() -> None:
    """By the kernel's own account of the process; where it gives large pages unasked, they are there before."""
    ask = (
        "import re; from pathlib import Path; from hil_gateway.process.scheduling import use_large_pages;"
        "held = bytearray(b'x') * (32 << 20); found = use_large_pages();"
        "large = re.search(r'AnonHugePages: +([0-9]+)', Path('/proc/self/smaps_rollup').read_text())[1];"
        "print(found, int(large) << 10, held.count(b'x') == 32 << 20)"
    )
    out = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True).stdout.split()
    assert int(out[1]) >= 24 << 20
    assert 24 << 20 <= int(out[0]) <= int(out[1])
    assert out[2] == "True"
