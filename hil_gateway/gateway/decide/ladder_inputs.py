"""What race control and the car say, read from the frames for the ladder."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.states import stronger_track_flag, stronger_vehicle_flag
from hil_gateway.gateway.decide.race_control import LadderInputs
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

SECOND_DEADLINE_S = 0.5
"""Flags of a second transmitter count while they are no older."""
FLAGS = ("vehicle_flag", "track_flag", "second_track_flag", "second_vehicle_flag", "second_sector_flag")

Flags = dict[str, int]
"""Quantity of `FLAGS` -> its code as it was received."""


def flags_in_force(builder: VehicleStateBuilder, now_ns: int) -> tuple[int, int]:
    """Track and vehicle flag: the more restrictive of the two transmitters."""
    track, vehicle = builder.track_flag("track_flag"), builder.vehicle_flag("vehicle_flag")
    if builder.age_s("race_control_flags", now_ns) > SECOND_DEADLINE_S:
        return track, vehicle
    second_track, second_vehicle = builder.track_flag("second_track_flag"), builder.vehicle_flag("second_vehicle_flag")
    return stronger_track_flag(track, second_track), stronger_vehicle_flag(vehicle, second_vehicle)


def flags_received(builder: VehicleStateBuilder) -> Flags:
    """Every flag as it was received, for the acknowledgements."""
    return {name: int(builder.value(name)) for name in FLAGS}


def caution_speed(builder: VehicleStateBuilder, declared: float) -> float:
    """Speed under yellow flags, m/s: the one race control names, if it does, and never above `declared`."""
    named = builder.value("target_speed")
    return min(named, declared) if named > 0.0 else declared


def ladder_inputs(builder: VehicleStateBuilder, now_ns: int, state: VehicleState) -> LadderInputs:
    """Inputs of the ladder."""
    return LadderInputs(
        car_alive=state.sources["vehicle"].valid,
        sys_state=state.sys_state,
        mode_switch=builder.mode_switch,
        heartbeat=int(builder.value("heartbeat")),
        heartbeat_age_s=builder.age_s("race_control", now_ns),
        track_flag=state.track_flag,
        vehicle_flag=state.vehicle_flag,
        rungs=builder.rungs,
    )
