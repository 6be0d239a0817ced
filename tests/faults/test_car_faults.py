"""Promises D1 and D2: single faults of sensors and actuators are noticed, and the stops keep to the road."""

from __future__ import annotations

import math

import pytest
from support.promise_figures import record_figure, volume
from verification.fault_simulation.car_campaign import FaultResult, campaign
from verification.fault_simulation.car_faults import CAR_FAULTS

FAULTS = {fault.name: fault for fault in CAR_FAULTS}
PHYSICS = {
    "steering stuck": "nothing but the brakes is left in a bend",
    "brakes dead": "the engine is cut, nothing else brakes",
    "throttle stuck at 60 %": "until the engine is cut the car gains speed",
    "position ramps by 5 m/s": "the only source of position, believed until it contradicts the wheels",
    "position drifts by 0.5 m/s": "nothing on board is independent of the one receiver",
}
"""fault -> why the car may leave the road"""
DEFECTS = {
    "IMU near zero": "noticed too late: the estimate has followed it when a bend tells",
    "IMU constant with dither": "noticed too late: the estimate has followed it when a bend tells",
}
"""fault -> what the gateway does not master yet; counted apart and shown with the promise"""
EXCEPTIONS = PHYSICS | DEFECTS


def unnoticed(result: FaultResult) -> bool:
    """Off the road before anything stopped the car."""
    return result.margin_unnoticed_m < 0.0 or result.harmful


@pytest.mark.slow
@pytest.mark.promise("D1")
@pytest.mark.promise("D2")
def test_single_faults_are_noticed_and_their_stops_keep_to_the_road() -> None:
    tracks = ("road_course", "oval", "tri_oval")[: volume(1, 3)]
    results = [r for track in tracks for r in campaign(track, volume(2, 40), volume(9, 3))]
    for result in results:
        fault = FAULTS[result.fault]
        if fault.noticed_by and result.noticed_s is not None:
            assert result.cause in fault.noticed_by, result
        if fault.noticed_by and math.isinf(result.margin_unnoticed_m):
            assert result.margin_m > 0.0, f"off the road, and nothing noticed: {result}"
    lost = [r for r in results if unnoticed(r) and r.fault not in EXCEPTIONS]
    assert not lost, lost
    stops = [r for r in results if r.noticed_s is not None]
    off = [r for r in stops if r.margin_m < 0.0]
    assert all(r.fault in EXCEPTIONS for r in off), [r for r in off if r.fault not in EXCEPTIONS]
    by_physics = ", ".join(sorted({r.fault for r in off if r.fault in PHYSICS})) or "none"
    defects = ", ".join(sorted({r.fault for r in off if r.fault in DEFECTS})) or "none"
    harmed = [r for r in results if unnoticed(r)]
    unseen = ", ".join(sorted({r.fault for r in harmed})) or "none"
    figure = f"{len(results)} single faults, {len(stops)} stopped, {len(harmed)} off the road unnoticed: {unseen}"
    record_figure("D1", figure, missed=bool(harmed))
    figure = f"{len(stops)} stops, {len(off)} off the road: physics {by_physics}; defects {defects}"
    record_figure("D2", figure, missed=any(r.fault in DEFECTS for r in off))
