"""Promises D1 and D2: single faults of sensors and actuators are noticed, and the stops keep to the road.

The test fails on a fault that takes the car off the road unnoticed, on a wrong cause and on a car that does not stand;
how many stops leave the road where the plant shows that one could have kept to it is a figure, and the verdict of D2 is
that figure against what it requires. The usual run
takes every sixth fault from one place and the next ones from another; `hil verify --car-faults` takes all of them.
"""

from __future__ import annotations

import math

import pytest
from support.promise_figures import record_figure, volume

from benchmarks.faults.car_campaign import PHYSICS, FaultResult, campaign
from benchmarks.faults.car_faults import CAR_FAULTS
from benchmarks.faults.healthy import drives, summary

FAULTS = {fault.name: fault for fault in CAR_FAULTS}
UNBRAKED = ("brakes dead", "drive-by-wire disabled")
"""faults with which the car only rolls out"""
ROAD_SHARE = 0.01
"""of the stops may leave the road where physics allows one on it (D2: 99 % keep to it)"""


def unnoticed(result: FaultResult) -> bool:
    """Off the road before anything stopped the car."""
    return result.margin_unnoticed_m < 0.0 or result.harmful


@pytest.mark.slow
@pytest.mark.promise("D1")
@pytest.mark.promise("D2")
def test_single_faults_are_noticed_by_the_right_cause_and_stop_the_car() -> None:
    tracks = ("road_course", "oval", "tri_oval")[: volume(1, 3)]
    results = [r for track in tracks for r in campaign(track, volume(1, 40), volume(18, 3), shares=volume(6, 1))]
    for result in results:
        fault = FAULTS[result.fault]
        if fault.noticed_by and result.noticed_s is not None:
            assert result.cause in fault.noticed_by, result
        if fault.noticed_by and math.isinf(result.margin_unnoticed_m):
            assert result.margin_m > 0.0, f"off the road, and nothing noticed: {result}"
    harmed = [r for r in results if unnoticed(r) and r.why != PHYSICS]
    assert all(r.noticed_s is not None for r in harmed), harmed
    stops = [r for r in results if r.noticed_s is not None]
    assert all(r.stands for r in stops if r.fault not in UNBRAKED), [r for r in stops if not r.stands]
    off = [r for r in stops if r.margin_m < 0.0]
    unseen = ", ".join(sorted({r.fault for r in harmed})) or "none"
    figure = f"{len(results)} single faults, {len(stops)} stopped, {len(harmed)} off the road unnoticed: {unseen}"
    record_figure("D1", figure, missed=bool(harmed))
    avoidable = [r for r in off if r.why != PHYSICS]
    others = ", ".join(f"by {-r.margin_m:.1f} m: {r.fault}" for r in avoidable) or "none"
    by_physics = len(off) - len(avoidable)
    figure = f"{len(stops)} stops, {len(off)} leave the road, {by_physics} by physics; others: {others}"
    record_figure("D2", figure, missed=len(avoidable) > ROAD_SHARE * len(stops))


@pytest.mark.slow
@pytest.mark.promise("D1")
def test_a_drive_without_a_fault_is_not_stopped() -> None:
    """Random cars the declared model does not fit; one that leaves the road by itself is stopped for that."""
    figures = summary(list(drives(volume(6, 72_000))))
    assert not figures["false_stops"], figures
    record_figure("D1", f"{figures['hours']} h of {figures['cars']} random cars without a fault: 0 false stops")
