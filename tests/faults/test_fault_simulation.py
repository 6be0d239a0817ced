"""The whole loop under seeded faults: the promises hold in every one of them, and every seed can be repeated."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from support.promise_figures import record_figure, volume

from benchmarks.faults.faults import Kind, draw
from hil_gateway.process.clock import NS_PER_S

SEEDS = volume(16, 5000)

TESTS = Path(__file__).parents[1]
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(TESTS)}
"""of the processes that simulate: they fork, and single-threaded numerics make them repeatable"""

FOUND = (793, 1081, 1385, 2138, 2362, 2457, 3257, 3785, 4297, 4633, 4701)
"""Seeds that broke a promise once: a corrupt position far off the map was an exception in planner or estimator; an
estimate that had waited while the gateway was held up passed for new."""


@pytest.mark.slow
@pytest.mark.promise("L1")
@pytest.mark.promise("S1")
def test_the_promises_hold_under_seeded_faults():
    """With the seeds that once broke one, all from the same drive."""
    seeds = sorted({*range(SEEDS), *FOUND})
    report = simulated(f"from benchmarks.faults.campaign import run_campaign as run; result = run({seeds})")
    assert report["broken"] == [], "\n".join(f"{b['broken']}; repeat: {b['repeat']}" for b in report["broken"])
    assert report["seeds"] == len(seeds)
    assert set(report["kinds"]) == {kind.value for kind in Kind}
    assert min(report["actions"].get(name, 0) for name in ("drive", "controlled_stop", "emergency_stop")) > SEEDS / 50
    speed = f"{report['times_real_time']} times real time ({report['times_real_time_per_core']} per CPU second)"
    record_figure("L1", f"{len(seeds):,} seeds of the fault simulation, 0 broken, {speed}")
    record_figure("S1", f"{len(seeds):,} seeds of the fault simulation: every frame that left inside limits")


@pytest.mark.slow
@pytest.mark.long
def test_a_seed_alone_does_what_it_does_in_a_campaign():
    command = [sys.executable, "-m", "hil_gateway", "verify", "--seed", "5", "--json"]
    alone = subprocess.run(command, capture_output=True, text=True, check=True, env=ENVIRONMENT)
    among = simulated(
        "from dataclasses import asdict; from benchmarks.faults.campaign import Campaign;"
        "result = {r.seed: asdict(r) for r in Campaign().run([0, 5])}[5]"
    )
    assert json.loads(alone.stdout) == {**among, "ok": True}


def simulated(script):
    """`result` of a script in a process of its own."""
    command = [sys.executable, "-c", f"import json; {script}; print(json.dumps(result))"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ENVIRONMENT)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


def test_every_kind_of_fault_gets_its_share_of_seeds():
    kinds = Counter(episode.kind for seed in range(500) for episode in draw(seed, NS_PER_S))
    assert set(kinds) == set(Kind)
    assert min(kinds.values()) >= 500 // len(Kind)


def test_a_seed_always_draws_the_same_faults():
    assert [draw(seed, NS_PER_S) for seed in range(50)] == [draw(seed, NS_PER_S) for seed in range(50)]
