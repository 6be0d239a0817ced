"""Being on time: real-time priority where the user may ask for it, else what an ordinary process can have."""

from __future__ import annotations

import ctypes
import os
import platform
from pathlib import Path
from struct import Struct

REAL_TIME_PRIORITY = 10
SLICE_NS = 100_000
"""shortest time slice the kernel grants: who asks for less at a time is let in sooner"""
PR_SET_TIMERSLACK = 29
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""system call numbers; the C library has no function for it"""
SCHED_ATTR = Struct("=IIQiIQQQ")
"""struct sched_attr of <linux/sched/types.h>: size, policy, flags, nice, priority, runtime, deadline, period"""


def real_time(pid: int) -> bool:
    """Put every thread of a process before all ordinary work (SCHED_RR); False where the user may not.

    What it starts later runs as ordinary work again. Whoever gave it a real-time policy before knew better.
    """
    policy, priority = os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(REAL_TIME_PRIORITY)
    for task in Path(f"/proc/{pid}/task").glob("*"):
        try:
            if os.sched_getscheduler(int(task.name)) == os.SCHED_OTHER:
                os.sched_setscheduler(int(task.name), policy, priority)
        except ProcessLookupError:  # ended meanwhile
            continue
        except PermissionError:
            return False
    return True


def punctual() -> bool:
    """Have this thread woken on time, whatever else the computer does; False where only a little could be done.

    Without real-time priority there remain timers that are not put off to save wake-ups (prctl(2)) and a short time
    slice, for which the scheduler lets a thread in ahead of those that ask for a long one (since Linux 6.12).
    """
    if real_time(os.getpid()):
        return True
    libc = ctypes.CDLL(None)
    libc.prctl(PR_SET_TIMERSLACK, 1)
    number = SCHED_SETATTR.get(platform.machine())
    if number is not None:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        libc.syscall(number, 0, SCHED_ATTR.pack(SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, SLICE_NS, 0, 0), 0)
    return False
