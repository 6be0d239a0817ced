"""Messages of the bus with every field set, for tests of what passes them on."""

from __future__ import annotations

from typing import Any, cast

from hil_gateway.bus import messages as m


def _filled(kind: type[m.Message], given: dict[str, Any]) -> dict[str, Any]:
    """0 for every required number that is not given."""
    return {name: 0 for name, field in kind.model_fields.items() if field.is_required()} | given


def vehicle_state(stamp_ns: int, **given: Any) -> m.VehicleState:
    """Valid, with one fresh and one silent source."""
    sources = {
        "imu": m.SourceHealth(age_s=0.004, valid=True),
        "position": m.SourceHealth(age_s=None, valid=False),
    }
    fields = {"stamp_ns": stamp_ns, "valid": True, "sources": sources, **given}
    return cast(m.VehicleState, m.VehicleState.model_validate(_filled(m.VehicleState, fields)))


def estimate(stamp_ns: int, **given: Any) -> m.Estimate:
    """Valid, deviations 1 to 9."""
    fields = {
        "stamp_ns": stamp_ns, "state_stamp_ns": stamp_ns, "valid": True, "std": tuple(range(1, 10)), **given,
    }  # fmt: skip
    return cast(m.Estimate, m.Estimate.model_validate(_filled(m.Estimate, fields)))


def plan(stamp_ns: int, stages: int = 3) -> m.Plan:
    """Straight ahead at 10 m/s."""
    zeros = (0.0,) * stages
    ahead = tuple(0.5 * i for i in range(stages))
    return m.Plan(
        stamp_ns=stamp_ns, seq=0, state_stamp_ns=stamp_ns, status=m.PlanStatus.SOLVED, dt=0.05, x=ahead, y=zeros,
        yaw=zeros, vx=(10.0,) * stages, s=ahead, steer=zeros, drive=zeros, lap=0, revision="r", solve_ms=1.0,
    )  # fmt: skip


def gateway_status(stamp_ns: int, **given: Any) -> m.GatewayStatus:
    """Driving, nothing wrong."""
    words = {"mode": "armed", "bus": "virtual", "bus_state": "error_active", "cause": "", "missing_for_arming": ()}
    fields = {**words, "stamp_ns": stamp_ns, "armed": True, "action": m.FailsafeAction.DRIVE, **given}
    return cast(m.GatewayStatus, m.GatewayStatus.model_validate(_filled(m.GatewayStatus, fields)))
