"""The decision of one period: a pure function of what is seen and what was decided before."""

from __future__ import annotations

import math

import pytest

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.car.states import CtState
from hil_gateway.gateway.decide.decision import KILL, Decision, Situation, decide
from hil_gateway.gateway.decide.failsafe import MEASURES, TABLE, Failsafe, Inputs, WhileSilent
from hil_gateway.gateway.decide.race_control import LadderInputs, RaceControl

WELL = dict.fromkeys(MEASURES, 0.0)
LADDER = LadderInputs(
    car_alive=True, sys_state=9, mode_switch=True, heartbeat=1, heartbeat_age_s=0.01, track_flag=1, vehicle_flag=0
)


def situation(firing: str = "", standing: bool = True, request: OperatorAction | None = None) -> Situation:
    measures = WELL | ({firing: math.inf} if firing else {})
    return Situation(10**9, Inputs(measures, standing, request), LADDER)


def silent(ct_state: CtState) -> Decision:
    return Decision(race_control=RaceControl(ct_state, heartbeat=0, beat_ns=10**9))


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.cause)
def test_a_row_does_while_silent_what_its_column_says(row):
    fired = decide(situation(row.measure), silent(CtState.NOMINAL_RACE))
    acts = row.while_silent is not WhileSilent.NOTHING
    assert fired.action is FailsafeAction.SILENT
    assert (fired.race_control.ct_state is CtState.EMERGENCY) is acts
    if acts:
        assert fired.cause == next(r.cause for r in TABLE if r.measure == row.measure)


def test_an_emergency_of_the_car_does_not_hold_a_ladder_that_starts_over():
    for starting in (silent(CtState.INIT), silent(CtState.NOMINAL_RACE)._replace(restarting=True)):
        ct_state = decide(situation("car_emergency"), starting).race_control.ct_state
        assert ct_state is not CtState.EMERGENCY
        assert decide(situation("foreign_emergency"), starting).race_control.ct_state is CtState.EMERGENCY


def test_the_first_cause_of_a_silent_emergency_keeps_its_name():
    first = decide(situation("uncommanded_motion"), silent(CtState.NOMINAL_RACE))
    then = decide(situation("car_emergency"), first)
    assert then.cause == "uncommanded_motion"


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize(("after_s", "named"), [(0.1, "vehicle_flag_kill"), (3.0, "car_emergency")])
def test_an_e_kill_that_the_car_obeys_before_it_says_so_gives_its_name(armed, after_s, named):
    first = silent(CtState.NOMINAL_RACE)._replace(calm_ns=10**9)
    first = first._replace(failsafe=Failsafe(FailsafeAction.DRIVE)) if armed else first
    emergency = decide(situation("car_emergency"), first)
    assert emergency.cause == "car_emergency"
    both = situation("car_emergency")._replace(now_ns=10**9 + round(after_s * 1e9))
    both = both._replace(conditions=both.conditions._replace(measures={**both.conditions.measures, KILL: math.inf}))
    assert decide(both, emergency).cause == named


def test_a_decision_is_a_function_of_its_arguments():
    before = Decision(Failsafe(FailsafeAction.DRIVE), RaceControl(CtState.NOMINAL_RACE, 0, 10**9))
    stop = situation("command_age", standing=False)
    assert decide(stop, before) == decide(stop, before)
    assert decide(stop, before).stopping
    assert before.action is FailsafeAction.DRIVE


def test_disarming_a_standing_car_starts_the_ladder_over_until_the_car_is_there_too():
    armed = Decision(Failsafe(FailsafeAction.DRIVE), RaceControl(CtState.NOMINAL_RACE, 0, 10**9), commanded_ns=10**9)
    after = decide(situation(request=OperatorAction.DISARM), armed)
    assert after.restarting and after.race_control.ct_state is CtState.INIT
    assert decide(situation(), after).restarting
    back = situation()._replace(ladder=LADDER._replace(sys_state=2))
    assert decide(back, after).restarting, "the car may not have noticed yet that the commands have ended"
    assert not decide(back._replace(now_ns=10**9 + 600_000_000), after).restarting


@pytest.mark.parametrize("ct_state", [CtState.CRANK_READY, CtState.CRANKING, CtState.NOMINAL_RACE])
def test_a_car_that_starts_over_takes_the_ladder_with_it(ct_state):
    back = situation()._replace(ladder=LADDER._replace(sys_state=1))
    assert decide(back, silent(ct_state)).race_control.ct_state is CtState.INIT
    assert decide(back, silent(CtState.ACTUATOR_TEST)).race_control.ct_state is CtState.ACTUATOR_TEST


@pytest.mark.parametrize("cause", ["", "operator_stop"])
def test_disarming_a_car_that_is_held_keeps_the_engine(cause):
    action = FailsafeAction.CONTROLLED_STOP if cause else FailsafeAction.DRIVE
    armed = Decision(Failsafe(action, cause), RaceControl(CtState.NOMINAL_RACE, 0, 10**9))
    disarming = situation(request=OperatorAction.DISARM)
    after = decide(disarming._replace(may_hold=True), armed)
    assert after.holding and not after.restarting
    assert after.race_control.ct_state is CtState.NOMINAL_RACE
    assert decide(disarming, armed).restarting, "commands end, and the car sees it"


@pytest.mark.parametrize("ct_state", [CtState.NOMINAL_RACE, CtState.EMERGENCY])
@pytest.mark.parametrize("may_hold", [True, False])
def test_brakes_hold_until_the_ladders_begin_anew(ct_state, may_hold):
    before = silent(ct_state)
    assert decide(situation()._replace(may_hold=may_hold), before).holding == may_hold
    disarmed = decide(situation(request=OperatorAction.DISARM)._replace(may_hold=may_hold), before)
    assert disarmed.holding == (may_hold and ct_state is not CtState.EMERGENCY)
