"""The ct_state ladder: one rung at a time, only upwards on the car's answer, down at once."""

from __future__ import annotations

import pytest

from hil_gateway.car.states import CtState, stronger_track_flag, stronger_vehicle_flag
from hil_gateway.gateway.decide.race_control import Demand, LadderInputs, RaceControl, missing_for_crank

INPUTS = LadderInputs(
    car_alive=True, sys_state=9, mode_switch=True, heartbeat=1, heartbeat_age_s=0.01, track_flag=1, vehicle_flag=0
)
CALM, CRANKED = Demand(), Demand(crank=True)


def at(ct: CtState, inputs: LadderInputs, demand: Demand = CALM) -> CtState:
    return RaceControl(ct, heartbeat=0, beat_ns=0).step(10_000_000, inputs, demand).ct_state


@pytest.mark.parametrize(
    ("ct", "needed", "below"),
    [(1, 1, 0), (2, 2, 1), (3, 4, 3), (4, 5, 4), (5, 8, 7), (6, 8, 7), (7, 9, 8)],
)
def test_each_rung_waits_for_the_car(ct, needed, below):
    waiting, answered = INPUTS._replace(sys_state=below), INPUTS._replace(sys_state=needed)
    expected = CtState.NOMINAL_RACE if ct == 7 else CtState(ct + 1)
    assert at(CtState(ct), answered, CRANKED) is expected
    assert at(CtState(ct), waiting, CRANKED) is CtState(ct)


@pytest.mark.parametrize("ct", range(1, 8))
@pytest.mark.parametrize("sys_state", [10, 16, 18, 0])
def test_a_car_that_is_not_on_the_ladder_does_not_lift_it(ct, sys_state):
    assert at(CtState(ct), INPUTS._replace(sys_state=sys_state)) <= ct


def test_the_engine_is_not_cranked_without_the_switch_at_the_car():
    assert at(CtState.CRANK_READY, INPUTS._replace(mode_switch=False), CRANKED) is CtState.CRANK_READY


@pytest.mark.parametrize("sys_state", range(1, 19))
def test_the_engine_is_not_cranked_without_a_person_s_request(sys_state):
    inputs = INPUTS._replace(sys_state=sys_state)
    assert at(CtState.CRANK_READY, inputs) is CtState.CRANK_READY
    would = at(CtState.CRANK_READY, inputs, CRANKED) is CtState.CRANKING
    assert would == (missing_for_crank(CtState.CRANK_READY, inputs) == ())


@pytest.mark.parametrize("change", [
    {"track_flag": 3}, {"track_flag": 0}, {"vehicle_flag": 34}, {"vehicle_flag": 32}, {"vehicle_flag": 4},
    {"heartbeat_age_s": 9.0, "heartbeat": 0},
])  # fmt: skip
def test_driving_needs_race_control_s_release(change):
    inputs = INPUTS._replace(sys_state=8, **change)
    control = RaceControl(CtState.RACE_READY, heartbeat=0, beat_ns=0)
    assert control.step(2_000_000_000, inputs, CALM).ct_state is CtState.RACE_READY


@pytest.mark.parametrize(("change", "pace"), [({}, 9), ({"track_flag": 9}, 8), ({"vehicle_flag": 7}, 8)])
def test_flags_set_the_pace(change, pace):
    for ct in (CtState.CAUTION, CtState.NOMINAL_RACE):
        assert at(ct, INPUTS._replace(**change)) == pace


def test_a_stop_is_left_by_arming_only():
    assert at(CtState.NOMINAL_RACE, INPUTS, Demand(stop=True)) is CtState.COORDINATED_STOP
    assert at(CtState.COORDINATED_STOP, INPUTS, CALM) is CtState.COORDINATED_STOP
    assert at(CtState.COORDINATED_STOP, INPUTS, Demand(armed=True)) is CtState.NOMINAL_RACE


@pytest.mark.parametrize("ct", range(1, 13))
def test_emergency_comes_from_everywhere_and_ends_only_with_a_restart(ct):
    assert at(CtState(ct), INPUTS, Demand(emergency=True)) is CtState.EMERGENCY
    assert at(CtState.EMERGENCY, INPUTS, CALM) is CtState.EMERGENCY
    assert at(CtState(ct), INPUTS, Demand(restart=True)) is CtState.INIT
    assert at(CtState(ct), INPUTS, Demand(emergency=True, restart=True)) is CtState.EMERGENCY


def test_a_repeated_heartbeat_is_a_frozen_one():
    control = RaceControl()
    assert control.heartbeat_frozen_s(5) == float("inf")
    control = control.step(0, INPUTS, CALM)
    control = control.step(400_000_000, INPUTS, CALM)
    assert control.heartbeat_frozen_s(400_000_000) == pytest.approx(0.4)
    control = control.step(450_000_000, INPUTS._replace(heartbeat=2), CALM)
    assert control.heartbeat_frozen_s(450_000_000) == 0.0


def test_the_more_restrictive_flag_counts():
    assert stronger_vehicle_flag(7, 32) == 32
    assert stronger_vehicle_flag(4, 7) == 4
    assert stronger_vehicle_flag(0, 0) == 0
    assert stronger_track_flag(1, 3) == 3
    assert stronger_track_flag(9, 1) == 9
    assert stronger_track_flag(1, 14) == 1
