"""What race control and the car say, read from the frames for the ladder."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.states import stronger_track_flag, stronger_vehicle_flag
from hil_gateway.gateway.decide.race_control import LadderInputs
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

MARELLI_DEADLINE_S = 0.5
"""Flags of `marelli_report_1` count while they are no older."""

Flags = tuple[int, int, int, int, int]
"""Vehicle and track flag of `base_to_car_summary`; track, vehicle and sector flag of `marelli_report_1`."""


def flags_in_force(builder: VehicleStateBuilder, now_ns: int) -> tuple[int, int]:
    """Track and vehicle flag: the more restrictive of the two senders."""
    vehicle, track, marelli_track, marelli_vehicle, _ = flags_received(builder)
    if builder.age_s("marelli_report_1", now_ns) > MARELLI_DEADLINE_S:
        return track, vehicle
    return stronger_track_flag(track, marelli_track), stronger_vehicle_flag(vehicle, marelli_vehicle)


def flags_received(builder: VehicleStateBuilder) -> Flags:
    """Every flag as it was received, for the acknowledgements."""
    names = ("veh_flag", "track_flag", "marelli_track_flag", "marelli_vehicle_flag", "marelli_sector_flag")
    vehicle, track, marelli_track, marelli_vehicle, sector = (int(builder.signal(name)) for name in names)
    return vehicle, track, marelli_track, marelli_vehicle, sector


def caution_speed(builder: VehicleStateBuilder, declared: float) -> float:
    """Speed under yellow flags, m/s: the one race control names, if it does, and never above `declared`."""
    named = builder.signal("round_target_speed")
    return min(named, declared) if named > 0.0 else declared


def ladder_inputs(builder: VehicleStateBuilder, now_ns: int, state: VehicleState) -> LadderInputs:
    """Inputs of the ladder."""
    return LadderInputs(
        car_alive=state.sources["vehicle"].valid,
        sys_state=state.sys_state,
        mode_switch=builder.signal("mode_switch_state") > 0,
        heartbeat=int(builder.signal("base_to_car_heartbeat")),
        heartbeat_age_s=builder.age_s("base_to_car_summary", now_ns),
        track_flag=state.track_flag,
        vehicle_flag=state.vehicle_flag,
    )
