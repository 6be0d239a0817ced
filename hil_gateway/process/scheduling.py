"""Being on time: real-time priority where the user may ask for it, else what an ordinary process can have.

Also memory in large pages, so that a process that sleeps between its periods finds it again sooner.
"""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import resource
from collections.abc import Iterator, Mapping
from pathlib import Path
from struct import Struct

PRIORITIES: Mapping[str, int] = {"gateway": 80, "plant": 70, "receiver": 65, "estimator": 60, "planner": 40}
"""process -> priority (sched(7), 1..99) where it is permitted, as in deploy/systemd: whoever sends by the millisecond
comes first, whoever computes longest last, and the kernel's own threads (99) before all"""
SLICE_NS = 100_000
"""shortest time slice the kernel grants: who asks for less at a time is let in sooner"""
CAP_SYS_NICE = 23
"""bit of <linux/capability.h>: any priority"""
PR_SET_TIMERSLACK = 29
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""system call numbers; the C library has no function for it"""
SCHED_ATTR = Struct("=IIQiIQQQ")
"""struct sched_attr of <linux/sched/types.h>: size, policy, flags, nice, priority, runtime, deadline, period"""
LARGE_PAGE = 2 << 20
"""bytes: one entry of the page table for 512 ordinary pages, on x86_64 and on aarch64 with pages of 4 KiB"""
MADV_COLLAPSE = 25
"""madvise(2), since Linux 6.1: put a range into large pages now"""
log = logging.getLogger(__name__)


def permitted(name: str) -> bool:
    """Whether this user may give the process `name` its priority."""
    status = Path("/proc/self/status").read_text()
    capabilities = int(status.partition("CapEff:")[2].split()[0], 16)
    within = resource.getrlimit(resource.RLIMIT_RTPRIO)[0] >= PRIORITIES[name]
    return within or bool(capabilities & 1 << CAP_SYS_NICE)


def real_time(name: str, pid: int) -> bool:
    """Put every thread of the process `name` before all ordinary work (SCHED_RR); False where the user may not.

    What it starts later runs as ordinary work again. Whoever gave it a real-time policy before knew better.
    """
    policy, priority = os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITIES[name])
    for task in Path(f"/proc/{pid}/task").glob("*"):
        try:
            if os.sched_getscheduler(int(task.name)) == os.SCHED_OTHER:
                os.sched_setscheduler(int(task.name), policy, priority)
        except ProcessLookupError:  # ended meanwhile
            continue
        except PermissionError:
            return False
    return True


def punctual(name: str) -> bool:
    """Have this thread of the process `name` woken on time, whatever else the computer does.

    False, and a warning in the log, where only a little could be done.

    Without real-time priority there remain timers that are not put off to save wake-ups (prctl(2)) and a short time
    slice, for which the scheduler lets a thread in ahead of those that ask for a long one (since Linux 6.12).
    """
    if real_time(name, os.getpid()):
        return True
    log.warning("real-time priority is not permitted: the %s may be late while this computer is busy", name)
    libc = ctypes.CDLL(None)
    libc.prctl(PR_SET_TIMERSLACK, 1)
    number = SCHED_SETATTR.get(platform.machine())
    if number is not None:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        libc.syscall(number, 0, SCHED_ATTR.pack(SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, SLICE_NS, 0, 0), 0)
    return False


def use_large_pages() -> int:
    """Put the memory that this process has by now into large pages; bytes in them then, 0 where the kernel cannot.

    A process that sleeps 40 ms finds nothing of it in the processor's caches; with large pages it looks up fewer
    addresses. Call it once, at the end of the start: each page is copied.
    """
    libc = ctypes.CDLL(None)
    pages = [ctypes.c_void_p(at) for at in _whole_pages(Path("/proc/self/maps").read_text())]
    done = [libc.madvise(page, ctypes.c_size_t(LARGE_PAGE), MADV_COLLAPSE) == 0 for page in pages]
    return LARGE_PAGE * done.count(True)


def _whole_pages(maps: str) -> Iterator[int]:
    """Addresses of large pages that lie within writable memory without a file, of /proc/PID/maps (proc(5))."""
    for line in maps.splitlines():
        where, rights, _, _, inode, *name = line.split(maxsplit=5)
        if rights == "rw-p" and inode == "0" and (not name or name == ["[heap]"]):
            first, end = (int(address, 16) for address in where.split("-"))
            yield from range(-(-first // LARGE_PAGE) * LARGE_PAGE, end - LARGE_PAGE + 1, LARGE_PAGE)
