"""The failsafe table against an oracle written from docs/failsafe.md by hand: arming, latching, priorities."""

from __future__ import annotations

import math
import random

import pytest
from support.promise_figures import record_figure, volume

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.gateway.decide.failsafe import (
    MEASURES,
    ROWS,
    TABLE,
    Failsafe,
    Inputs,
    WhileSilent,
    first_firing,
    first_firing_while_silent,
    missing_for_arming,
    table_markdown,
)

# The oracle: what must happen, written down a second time without looking at the code's table. It uses the actions'
# numbers and sets instead of rows: 0 silent, 1 drive, 2 controlled stop, 3 emergency stop with the engine on, 4 with it
# off.
EMERGENCY_AT = {
    "operator_emergency": 0.0, "vehicle_flag_kill": 0.0, "car_emergency": 0.0, "foreign_emergency": 0.0,
    "uncommanded_motion": 0.0, "steering_stuck": 0.1, "pedals_stuck": 0.1, "commands_unanswered": 0.15,
    "can_silence": 0.1, "gateway_gap": 0.1,
}  # fmt: skip
HARD_STOP_AT = {"command_age": 0.5}
STOP_AT = {
    "operator_stop": 0.0, "command_age": 0.1, "state_invalid": 0.05, "estimate_invalid": 0.05, "counters_wrong": 0.0,
    "heading_unknown": 0.0, "gateway_ending": 0.0,
    "foreign_commands": 0.0, "heartbeat_frozen": 0.5, "track_flag_stop": 0.0, "vehicle_flag_stop": 0.0,
    "car_not_driving": 0.0, "car_failure": 0.0, "engine_running": 0.0,
    "mode_switch_off": 0.0, "safety_switch": 0.0, "supply_low": 1.0, "engine_stalled": 0.3, "sender_doubled": 0.0,
    "tyre_flat": 0.3,
    "position_wrong": 0.0, "wheel_speed_wrong": 0.15, "yaw_rate_wrong": 0.15,
    "acceleration_wrong": 0.2, "position_lost": 1.0,
    "off_road": 0.05,
    "wrong_way": 0.2,
}  # fmt: skip
NUMBER = {"silent": (0,), "drive": (1,), "controlled_stop": (2,), "emergency_stop": (3, 4)}


def demanded(measures: dict[str, float]) -> int:
    def any_of(limits: dict[str, float]) -> bool:
        return any(measures[name] > 0 and measures[name] >= limit for name, limit in limits.items())

    return 4 if any_of(EMERGENCY_AT) else 3 if any_of(HARD_STOP_AT) else 2 if any_of(STOP_AT) else 0


def oracle(state: int, measures: dict[str, float], standing: bool, request: str | None, may_arm: bool) -> int:
    demand = demanded(measures)
    clear_to_arm = demand == 0 and standing and may_arm
    if state == 0:
        return 1 if request == "arm" and clear_to_arm else 0
    if request == "disarm" and standing:
        return 0
    worst = max(state, demand)
    if worst > state:
        return worst
    if state == 1 and request == "disarm":
        return 2
    if state in (2, 3) and request == "arm" and clear_to_arm:
        return 1
    return state


def random_measures(rng: random.Random) -> dict[str, float]:
    """Mostly all well, with a few conditions around their thresholds."""
    measures = dict.fromkeys(MEASURES, 0.0)
    for name in rng.sample(sorted(MEASURES), k=rng.choice((0, 0, 0, 1, 1, 2, 3))):
        measures[name] = rng.choice((0.0, 0.049, 0.05, 0.0999, 0.1, 0.3, 0.499, 0.5, 2.0, math.inf))
    return measures


@pytest.mark.promise("S7")
def test_an_oracle_written_from_the_table_agrees():
    rng = random.Random(7)
    sequences = volume(6_000, 100_000)
    reached: dict[str, int] = {}
    for sequence in range(sequences):
        failsafe, expected = Failsafe(), 0
        for step in range(10):
            measures = dict.fromkeys(MEASURES, 0.0) if rng.random() < 0.5 else random_measures(rng)
            request = rng.choice((None, None, *OperatorAction)) if step else OperatorAction.ARM
            standing, may_arm = rng.random() < 0.7, rng.random() < 0.95
            failsafe = failsafe.step(Inputs(measures, standing, request, may_arm))
            expected = oracle(expected, measures, standing, request and request.value, may_arm)
            assert expected in NUMBER[failsafe.action.value], (sequence, step, measures, standing, request, failsafe)
            assert failsafe.engine_off == (expected == 4), (sequence, step, measures, failsafe)
            reached[failsafe.action.value] = reached.get(failsafe.action.value, 0) + 1
    assert min(reached.get(name, 0) for name in NUMBER) > sequences / 10
    record_figure("S7", f"{sequences:,} sequences of 10 periods agree with the oracle")


def test_the_oracle_knows_every_measure():
    assert set(EMERGENCY_AT) | set(HARD_STOP_AT) | set(STOP_AT) == MEASURES


def test_the_documented_table_is_the_code_s():
    from pathlib import Path

    text = (Path(__file__).resolve().parents[5] / "docs" / "failsafe.md").read_text()
    assert table_markdown() in text, "docs/failsafe.md: replace its table with failsafe.table_markdown()"


@pytest.mark.promise("S5")
def test_one_missing_condition_is_enough_to_refuse_arming():
    good = Inputs(dict.fromkeys(MEASURES, 0.0), standing=True, request=OperatorAction.ARM)
    assert Failsafe().step(good).action is FailsafeAction.DRIVE
    for row in TABLE:
        below = dict(good.measures) | {row.measure: max(row.threshold_s - 1e-6, 0.0)}
        at = dict(good.measures) | {row.measure: row.threshold_s or math.inf}
        assert row.cause not in missing_for_arming(Inputs(below, standing=True))
        assert Failsafe().step(Inputs(at, True, OperatorAction.ARM)).action is FailsafeAction.SILENT
        assert row.cause in missing_for_arming(Inputs(at, standing=True))
        absent = {name: held for name, held in good.measures.items() if name != row.measure}
        assert Failsafe().step(Inputs(absent, True, OperatorAction.ARM)).action is FailsafeAction.SILENT
    record_figure("S5", f"arming refused with each of {len(TABLE)} rows alone at its threshold, or its measure missing")


@pytest.mark.promise("S5")
def test_arming_needs_standstill_and_a_mode_that_allows_it():
    well = dict.fromkeys(MEASURES, 0.0)
    assert missing_for_arming(Inputs(well, standing=False)) == ("car_moving",)
    assert missing_for_arming(Inputs(well, standing=True, may_arm=False)) == ("mode",)
    assert Failsafe().step(Inputs(well, False, OperatorAction.ARM)).action is FailsafeAction.SILENT
    assert Failsafe().step(Inputs(well, True, OperatorAction.ARM, may_arm=False)).action is FailsafeAction.SILENT
    record_figure("S5", "arming refused while moving and in a mode without transmission")


@pytest.mark.promise("S5")
def test_not_a_number_fires():
    measures = dict.fromkeys(MEASURES, 0.0) | {"command_age": math.nan}
    assert first_firing(Inputs(measures, standing=True)).cause == "command_dead"


def test_the_first_cause_of_an_action_keeps_its_name():
    well = dict.fromkeys(MEASURES, 0.0)
    failsafe = Failsafe().step(Inputs(well, True, OperatorAction.ARM))
    failsafe = failsafe.step(Inputs(well | {"heartbeat_frozen": 1.0}, False))
    assert failsafe.cause == "heartbeat_frozen"
    failsafe = failsafe.step(Inputs(well | {"operator_stop": math.inf}, False))
    assert failsafe.cause == "heartbeat_frozen"
    failsafe = failsafe.step(Inputs(well | {"operator_stop": math.inf, "can_silence": 1.0}, False))
    assert (failsafe.action, failsafe.cause) == (FailsafeAction.EMERGENCY_STOP, "can_silent")


def test_while_silent_only_rows_that_act_then_are_seen():
    well = dict.fromkeys(MEASURES, 0.0)
    assert first_firing_while_silent(Inputs(well, standing=True)) is None
    for row in TABLE:
        alone = well | {row.measure: row.threshold_s or math.inf}
        seen = first_firing_while_silent(Inputs(alone, standing=True))
        assert (seen == row) == (row.while_silent is not WhileSilent.NOTHING)


@pytest.mark.parametrize("action", FailsafeAction)
def test_commands_are_sent_in_every_state_but_silence(action):
    assert Failsafe(action).armed == (action is not FailsafeAction.SILENT)


def test_a_row_by_itself_fires_as_in_the_table() -> None:
    row = ROWS["can_silent"]
    assert row.fires({})
    assert row.fires({row.measure: row.threshold_s})
    assert not row.fires({row.measure: 0.99 * row.threshold_s})
