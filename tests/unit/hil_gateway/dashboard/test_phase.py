"""The page says what the car is doing, why it stands, and what a person has to decide next."""

from __future__ import annotations

from typing import Any

import pytest
from unit.hil_gateway.session.test_catalogue import estimate

from hil_gateway.bus import messages as m
from hil_gateway.bus.topics import ESTIMATE, GATEWAY_STATUS, RUN, VEHICLE_STATE
from hil_gateway.bus.track_day.run import RunPhase, RunPlan, RunStatus
from hil_gateway.dashboard.phase import phase_of

FULL = ("cranked",)
"""what the gateway names once the engine runs"""


def alive(speed: float = 0.0, run: RunStatus | None = None, **status: Any) -> dict[str, Any]:
    given = {
        "armed": False,
        "action": "silent",
        "cause": "",
        "missing_for_arming": (),
        "missing_for_crank": FULL,
    } | status
    gateway = m.GatewayStatus(
        stamp_ns=0, seq=0, mode="armed", bus="udp", bus_state="error_active", frames_received=0, frames_lost=0,
        frames_unknown=0, frames_malformed=0, counter_errors=0, commands_sent=0, commands_limited=0,
        loop_latency_p50_ms=None, loop_latency_p99_ms=None, **given,
    )  # fmt: skip
    found: dict[str, Any] = {
        GATEWAY_STATUS.key: gateway,
        ESTIMATE.key: estimate(0, 0.0, 0.0).model_copy(update={"vx": speed}),
    }
    return found | ({RUN.key: run} if run else {})


def run(phase: RunPhase, **given: Any) -> RunStatus:
    return RunStatus(stamp_ns=0, seq=0, phase=phase, number=1, plan=RunPlan(laps=3), **given)


DRIVING = {"armed": True, "action": "drive"}
STOPPED = {"armed": True, "action": "controlled_stop", "cause": "track_flag_stop"}
DEAD = STOPPED | {"cause": "command_dead", "missing_for_arming": ("estimate_invalid", "command_dead")}


@pytest.mark.parametrize(
    ("found", "name", "decide"),
    [
        ({}, "unknown", "hil gateway run"),
        (alive(missing_for_crank=()), "bench", "hil gateway crank"),
        (alive(missing_for_arming=("plan_standing",)), "bench", "the planner has no plan that drives off"),
        (alive(), "bench", "hil gateway arm"),
        (alive(20.0, **DRIVING), "out lap", "hil gateway stop"),
        (alive(20.0, run(RunPhase.FLYING, lap=2), **DRIVING), "flying, lap 2 of 3", "hil run in"),
        (alive(20.0, run(RunPhase.IN_LAP, stop_at=1200.0), **DRIVING), "in lap", "stops by itself at 1200 m"),
        (alive(20.0, run(RunPhase.IN_LAP, box=2, in_pit_lane=True), **DRIVING), "in lap (pit lane)", "in box 2"),
        (alive(20.0, run(RunPhase.OUT_LAP, box=2, in_pit_lane=True), **DRIVING), "out lap (pit lane)", "hil run in"),
        (alive(0.0, run(RunPhase.DONE, box=2, in_pit_lane=True), **DRIVING), "in its box, 2", "hil run next"),
        (alive(0.0, run(RunPhase.DONE, said="clean"), **DRIVING), "bench", "hil run next"),
        (alive(20.0, **STOPPED), "stopped because red or checkered flag from race control", "hil gateway arm"),
        (alive(0.0, missing_for_crank=(), **STOPPED), "stopped because red", "hil gateway crank"),
        (alive(0.0, missing_for_arming=("estimate_invalid",), **STOPPED), "stopped", "hil estimator run"),
        (alive(0.0, **DEAD), "stopped because no planner sends commands", "no valid estimate: `hil estimator run`"),
        (alive(3.0), "moved by hand", "nothing"),
    ],
)
def test_a_phase_has_a_name_and_a_decision(found, name, decide):
    phase = phase_of(found, timed=False)
    assert phase["name"].startswith(name) and decide in phase["next"]
    assert "hil " not in phase["name"]


@pytest.mark.parametrize(("sys_state", "name"), [(2, "bench"), (8, "standing (held)"), (9, "standing (held)")])
def test_a_standing_car_whose_engine_runs_is_no_longer_on_the_bench(sys_state, name):
    state = {VEHICLE_STATE.key: m.VehicleState.model_construct(sys_state=sys_state)}
    assert phase_of(alive(holding=True) | state, timed=False)["name"] == name


def test_a_car_without_a_run_flies_once_its_lap_is_timed():
    assert phase_of(alive(20.0, **DRIVING), timed=True)["name"] == "flying"
