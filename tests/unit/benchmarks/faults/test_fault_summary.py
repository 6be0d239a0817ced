"""What a survey counts of the stops that leave the road."""

from __future__ import annotations

from benchmarks.faults.car_campaign import LATE, PHYSICS, STOP, FaultResult, summary


def result(margin_m: float, why: str = "") -> FaultResult:
    return FaultResult("IMU missing", 20.0, 50.0, 0.1, "state_invalid", True, margin_m, 1.0, why)


def test_the_stops_that_no_stop_could_hold_are_counted_from_the_fault_on_and_from_noticing_on():
    report = summary([result(0.5), result(-1.0, PHYSICS), result(-2.0, LATE), result(-3.0, LATE), result(-0.1, STOP)])
    single = report["single"]
    assert single["off the road by physics"] == 1
    assert single["not to be held by any stop once noticed"] == 3
    assert single["kept"] == 0.4
