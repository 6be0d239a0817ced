"""Speed of the whole loop in one process against real time, and which component takes it.

    python -m benchmarks.loop [--track FILE] [--seconds S] [--json]

CPU time of this process, so that what else the machine does does not count; the first seconds (compilers, standing
start) are left out.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

from hil_gateway.config import load_config
from planner.simulation.loop import Loop

WARM_UP_S = 8.0
COMPONENTS = ("plant", "gateway", "estimator", "planner")


def measured(track: str, seconds: float) -> dict[str, Any]:
    """Times real time, and ms of CPU per second of driving of each component."""
    loop = Loop(load_config(None, {"track": track}))
    while loop.elapsed_s < WARM_UP_S:
        loop.step()
    spent = dict.fromkeys(COMPONENTS, 0)
    for name in COMPONENTS:
        core = getattr(loop, name)
        core.step = _timed(core.step, spent, name)
    start_ns, start_s = time.process_time_ns(), loop.elapsed_s
    while loop.elapsed_s < start_s + seconds:
        loop.step()
    total_s = (time.process_time_ns() - start_ns) / 1e9
    result = loop.finish()
    return {
        "times_real_time": round(seconds / total_s, 2),
        "cpu_ms_per_s": {name: round(ns / 1e6 / seconds, 2) for name, ns in spent.items()},
        "off_track": result.off_track,
        "plan_failures": result.plan_failures,
    }


def _timed(step: Any, spent: dict[str, int], name: str) -> Any:
    def timed(now_ns: int) -> Any:
        start = time.thread_time_ns()
        result = step(now_ns)
        spent[name] += time.thread_time_ns() - start
        return result

    return timed


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--track", default="road_course")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = measured(arguments.track, arguments.seconds)
    if arguments.json:
        print(json.dumps(figures))
        return
    print(f"whole loop: {figures['times_real_time']} times real time (CPU)")
    for name, ms in figures["cpu_ms_per_s"].items():
        print(f"  {name:10} {ms:6.1f} ms per second of driving")


if __name__ == "__main__":
    main()
