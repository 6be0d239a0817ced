"""What the car is doing in the words of the pit wall, and what a person has to decide next. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil_gateway.bus.messages import GatewayStatus
from hil_gateway.bus.topics import ESTIMATE, GATEWAY_STATUS, RUN, VEHICLE_STATE
from hil_gateway.bus.track_day.run import UNDER_WAY, RunPhase, RunStatus
from hil_gateway.car.states import SysState
from hil_gateway.gateway.check.arming import EXPLANATION
from hil_gateway.gateway.decide.decision import STOPS
from hil_gateway.gateway.decide.failsafe import ROWS
from hil_gateway.gateway.perceive.road_speed import STANDSTILL


def phase_of(alive: Mapping[str, Any], timed: bool) -> dict[str, str]:
    """`name` of the phase and what to decide `next`, of what is alive on the bus by topic.

    `timed`: the lap clock runs, so that a car without a run is no longer on its out lap.
    """
    status: GatewayStatus | None = alive.get(GATEWAY_STATUS.key)
    if status is None:
        return _said("unknown", "find out where the car is: no gateway speaks (`hil gateway run`)")
    run: RunStatus | None = alive.get(RUN.key)
    if status.action in STOPS:
        cause = ROWS[status.cause].meaning if status.cause in ROWS else status.cause
        return _said(f"stopped because {cause}", _after_stop(status))
    if _speed(alive) >= STANDSTILL:
        return _moving(status, run, timed)
    return _standing(status, run, alive)


def _moving(status: GatewayStatus, run: RunStatus | None, timed: bool) -> dict[str, str]:
    if not status.armed:
        return _said("moved by hand", "nothing: the computer does not drive")
    lane = " (pit lane)" if run is not None and run.in_pit_lane else ""
    if run is None or run.phase not in UNDER_WAY:
        return _said(("flying" if timed else "out lap") + lane, "nothing; to end it: `hil gateway stop`")
    lane += f", at most {run.caps}" if run.caps else ""
    if run.phase is RunPhase.IN_LAP:
        return _said(run.phase.value + lane, f"nothing: it stops by itself{_place(run)}")
    lap = f", lap {run.lap} of {run.plan.laps}" if run.plan and run.phase is RunPhase.FLYING else ""
    return _said(f"{run.phase.value}{lap}{lane}", "nothing; to bring it in: `hil run in`")


def _standing(status: GatewayStatus, run: RunStatus | None, alive: Mapping[str, Any]) -> dict[str, str]:
    state = alive.get(VEHICLE_STATE.key)
    bench = state is None or state.sys_state not in (SysState.IDLE, SysState.DRIVING)
    name = "bench" if bench else "standing (held)" if status.holding or status.armed else "standing"
    if status.armed and run is not None and run.phase is RunPhase.DONE:
        name = f"in its box, {run.box}" if run.box is not None and run.in_pit_lane else name
        return _said(name, f"go on with `hil run next`, or `hil gateway disarm`; {run.said}")
    if status.armed:
        return _said(name, "nothing: it drives off by itself")
    if not status.missing_for_crank:
        return _said(name, "whether the engine may start: `hil gateway crank`")
    if status.missing_for_arming:
        return _said(name, f"before it can be armed: {_missing(status)}")
    return _said(name, "whether it may drive: `hil gateway arm`")


def _after_stop(status: GatewayStatus) -> str:
    if not status.missing_for_crank:
        return "whether the engine may start: `hil gateway crank`, then `hil gateway arm`"
    if status.missing_for_arming:
        return f"before it can be armed again: {_missing(status)}"
    return "whether it may drive: `hil gateway arm`"


def _missing(status: GatewayStatus) -> str:
    first = status.missing_for_arming[0]
    return status.advice.get(first) or EXPLANATION.get(first, first)


def _place(run: RunStatus) -> str:
    if run.box is not None:
        return f" in box {run.box}"
    return "" if run.stop_at is None else f" at {run.stop_at:.0f} m"


def _speed(alive: Mapping[str, Any]) -> float:
    estimate = alive.get(ESTIMATE.key)
    return 0.0 if estimate is None else abs(estimate.vx)


def _said(name: str, decide: str) -> dict[str, str]:
    return {"name": name, "next": decide}
