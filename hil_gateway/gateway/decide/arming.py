"""What arming asks beyond the failsafe table: whether the estimate fits, and whether the plan drives off."""

from __future__ import annotations

import math
from collections.abc import Mapping

from hil_gateway.agreement import disagreement
from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Agreement, Command, Estimate, Plan, PlanStatus
from hil_gateway.bus.track_day.run import RunStatus

APART_M = 1.0
"""between the newest fix and the estimate: as near as the way of a stop comes to the edges"""
UNDER_WAY = 0.5
"""m/s that a plan which drives off has"""
UNDER_WAY_S = 0.5
"""within so much of its horizon"""
DRIVES_OFF = (PlanStatus.SOLVED, PlanStatus.FIRST_METRES)


def unready(
    now_ns: int,
    estimate: Latest[Estimate],
    plan: Latest[Plan],
    command: Command | None,
    fix: tuple[float, float] | None,
) -> Mapping[str, str]:
    """Cause -> what to do about it, in words, for everything that does not fit; `fix` is the newest, m, map.

    Whoever publishes no plans is asked for a `command` that drives.
    """
    found = {}
    if estimate.message is not None and estimate.alive(now_ns) and fix is not None:
        apart_m = math.hypot(estimate.message.x - fix[0], estimate.message.y - fix[1])
        if not apart_m < APART_M:
            found["estimate_unfit"] = f"the estimate is {apart_m:.1f} m from the position fix: push the car, or wait"
    newest = plan.message
    if newest is None or not plan.alive(now_ns):
        if command is None or command.drive <= 0.0:
            found["plan_standing"] = "neither a plan nor a command that drives: `hil planner run`"
    elif newest.status not in DRIVES_OFF or not _drives_off(newest):
        found["plan_standing"] = newest.reason or "the plan does not drive off"
    return found


def of_another_drive(ours: Agreement, estimate: Estimate | None, plan: Plan | None) -> dict[str, str]:
    """Cause -> what to do about it, where a sender works with another car, or on another track, than `ours`."""
    senders = (("estimator", estimate), ("planner", plan))
    said = "; ".join(filter(None, (disagreement(ours, name, m.agreement) for name, m in senders if m is not None)))
    return {"disagreement": f"{said}: start all with the same track and car"} if said else {}


class LostRun:
    """A run that the planner knows nothing of, having been started anew: armed, it would drive without its caps."""

    def __init__(self) -> None:
        self._run = ""

    def step(self, status: RunStatus | None) -> dict[str, str]:
        """Cause -> what to do about it, of the planner's newest `status`: ask for the run again, or give it up."""
        if status is None:
            return {}
        if status.number > 0:
            self._run = f"run {status.number}" + (f" ({status.plan.name})" if status.plan and status.plan.name else "")
        elif status.answered and not status.refused:  # a person has given it up, at the new planner
            self._run = ""
        if status.number > 0 or not self._run:
            return {}
        return {"run_lost": f"a new planner knows nothing of {self._run}: `hil run start FILE`, or `hil run abort`"}


def _drives_off(plan: Plan) -> bool:
    return max(plan.vx[: round(UNDER_WAY_S / plan.dt) + 1], default=0.0) > UNDER_WAY
