"""Every measure of the failsafe table, from what the gateway sees in one period."""

from __future__ import annotations

from collections.abc import Mapping

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Agreement, Command, Estimate, FailsafeAction, OperatorAction, Plan, VehicleState
from hil_gateway.bus.track_day.run import RunPhase, RunStatus
from hil_gateway.car.states import (
    KILL_VEHICLE_FLAGS,
    STOP_TRACK_FLAGS,
    STOP_VEHICLE_FLAGS,
    CtState,
    SysState,
    VehicleFlag,
)
from hil_gateway.config import Config
from hil_gateway.gateway.decide.arming import LostRun, of_another_drive, unready
from hil_gateway.gateway.decide.decision import Decision, Situation
from hil_gateway.gateway.decide.failsafe import HOLDS, Inputs
from hil_gateway.gateway.decide.ladder_inputs import ladder_inputs
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.gateway.perceive.inbox import ESTIMATE_MAX_S, usable
from hil_gateway.gateway.perceive.road_speed import STANDSTILL, road_speed
from hil_gateway.gateway.perceive.tyre_reports import TyreReports
from hil_gateway.gateway.perceive.vehicle_state import COUNTER_FAULT, VehicleStateBuilder
from hil_gateway.gateway.requests import REQUESTS
from hil_gateway.process.clock import NS_PER_S

UNCOMMANDED = 1.0
"""m/s; a car in sys_state driving that moves so fast while nobody sends commands obeys old ones"""
DRIVING_ONLY = (
    "command_age", "estimate_invalid", "heading_unknown", "heartbeat_frozen", "car_not_driving", "mode_switch_off",
    "engine_stalled",
)  # fmt: skip
"""Measures that have no meaning while actuators are tested with the engine off."""
OBEYS_BRAKES = (SysState.IDLE, SysState.DRIVING)
"""In driving the car does; commands begin the state before, so that its own brakes hand over to them."""
LISTENS_NS = NS_PER_S // 10
"""ten periods of another computer's commands"""
ENGINE_TURNS = 40.0
"""rad/s (380 rpm): starters crank slower, no engine idles so slow"""


FIRST_METRES = 6.0
"""m driven straight ahead after which it is known where a car points: two or three show it"""
STOPPING_REQUESTS = {action: f"operator_{action}" for action, row in REQUESTS.items() if row.stops}
"""request -> its measure"""


class Conditions:
    """Remembers since when state and estimate are invalid and when the gateway ran last."""

    def __init__(
        self, builder: VehicleStateBuilder, tyres: TyreReports, config: Config, ours: Agreement | None = None
    ) -> None:
        self._builder, self._tyres = builder, tyres
        self._mode, self._ours = config.gateway.mode, ours
        self._testing = self._mode == "actuator_test"
        self._sends = self._mode in ("armed", "actuator_test")
        self._holds = config.gateway.hold and self._mode == "armed"
        self._supply_min = config.car.actuators.supply_voltage_min or 0.0
        self._began_ns: int | None = None
        self._state_invalid, self._estimate_invalid = ConditionTime(), ConditionTime()
        self._supply_low, self._stalled, self._black_flag = ConditionTime(), ConditionTime(), ConditionTime()
        self._last_ns: int | None = None
        self._needs_heading = config.gateway.arming.heading == "known"
        self.ending = False
        """whether this process is to end"""
        self._lost_run = LostRun()
        self._blind_m = 0.0
        """driven without knowing where the car points"""

    def situation(  # noqa: PLR0917 - what a decision depends on
        self,
        now_ns: int,
        state: VehicleState,
        request: OperatorAction | None,
        decision: Decision,
        command_age_s: float,
        estimate: Latest[Estimate],
        monitored: Mapping[str, float],
        plan: Latest[Plan],
        command: Command | None,
        run: Latest[RunStatus],
    ) -> Situation:
        """Inputs of this period's decision; `decision` is the one in force, `monitored` what the monitors measure."""
        measures = self.measures(
            now_ns,
            state,
            request,
            answers_for_motion=decision.failsafe.armed or not self._sends,
            command_age_s=command_age_s,
            estimate=estimate,
            heartbeat_frozen_s=decision.race_control.heartbeat_frozen_s(now_ns),
            comes_in=_comes_in(run, self._black_flag.update(state.vehicle_flag == VehicleFlag.BLACK, now_ns), now_ns),
        )
        standing = state.valid and road_speed(state) < STANDSTILL
        lost = self._lost_run.step(run.message)
        asked = not self._testing and decision.action is not FailsafeAction.DRIVE  # a car that drives is armed
        everything = {**measures, **(dict.fromkeys(monitored, 0.0) if self._testing else monitored)}
        return Situation(
            now_ns,
            Inputs(
                everything,
                standing,
                request,
                self._mode != "listen",
                self._unready(now_ns, estimate, plan, command, lost) if asked else {},
            ),
            ladder_inputs(self._builder, now_ns, state),
            CtState.ACTUATOR_TEST if self._testing else CtState.NOMINAL_RACE,
            self._sends,
            self._alone(now_ns) and self._holds and _obeys(state),
        )

    def measures(
        self,
        now_ns: int,
        state: VehicleState,
        request: OperatorAction | None,
        *,
        answers_for_motion: bool,
        command_age_s: float,
        estimate: Latest[Estimate],
        heartbeat_frozen_s: float,
        comes_in: bool = False,
    ) -> dict[str, float]:
        """Measure -> seconds it has held; once a period.

        `answers_for_motion`: commands are sent, or the mode leaves the actuators to somebody else.
        `comes_in`: the planner answers for a black flag.
        """
        measures = {
            **_requested(request, state, comes_in),
            **self._of_the_car(now_ns, state),
            **self._on_the_bus(now_ns),
            "uncommanded_motion": _holds(not answers_for_motion and _drives_on(state)),
            "gateway_ending": _holds(self.ending),
            "engine_running": 0.0,
            "command_age": command_age_s,
            "gateway_gap": 0.0 if self._last_ns is None else (now_ns - self._last_ns) / NS_PER_S,
            "heartbeat_frozen": heartbeat_frozen_s,
            "state_invalid": self._state_invalid.update(not state.valid, now_ns),
            "estimate_invalid": self._without_estimate(estimate, now_ns),
            "heading_unknown": self._without_heading(now_ns, state, estimate, answers_for_motion),
        }
        if self._testing:
            running = state.engine_speed > 0 or state.sys_state >= SysState.IDLE
            measures |= dict.fromkeys(DRIVING_ONLY, 0.0) | {"engine_running": _holds(running)}
        self._last_ns = now_ns
        return measures

    def _unready(
        self, now_ns: int, estimate: Latest[Estimate], plan: Latest[Plan], command: Command | None,
        lost: Mapping[str, str],
    ) -> Mapping[str, str]:  # fmt: skip
        fixes = self._builder.fixes
        found = unready(now_ns, estimate, plan, command, (fixes.x, fixes.y) if fixes.seq else None)
        other = {} if self._ours is None else of_another_drive(self._ours, estimate.message, plan.message)
        return {**other, **lost, **found}

    def _without_heading(
        self, now_ns: int, state: VehicleState, estimate: Latest[Estimate], driven: bool
    ) -> float:  # fmt: skip
        """Holds where the car does not know where it points: at once, or after the first metres that are to show it."""
        lacks = estimate.message is not None and estimate.message.lacks == "heading"
        if not (lacks and driven):
            self._blind_m = 0.0
        elif self._last_ns is not None:
            self._blind_m += road_speed(state) * (now_ns - self._last_ns) / NS_PER_S
        return _holds(lacks and (self._needs_heading or self._blind_m > FIRST_METRES))

    def _alone(self, now_ns: int) -> bool:
        """Whether no other computer commands the car, as far as one that has just begun to listen can tell; asked in
        every period, for it listens from the first one on."""
        self._began_ns = now_ns if self._began_ns is None else self._began_ns
        return now_ns - self._began_ns >= LISTENS_NS and not self._builder.another("commands", now_ns)

    def _of_the_car(self, now_ns: int, state: VehicleState) -> dict[str, float]:
        """What the car reports of itself."""
        builder = self._builder
        return {
            "car_emergency": _holds(state.sys_state in (SysState.EMERGENCY, SysState.CRITICAL_LIMIT)),
            "car_not_driving": _holds(state.sys_state != SysState.DRIVING),
            "car_failure": _holds(builder.failing),
            "mode_switch_off": _holds(not builder.mode_switch),
            "safety_switch": _holds(builder.value("safety_switch") != 0),
            "supply_low": self._supply_low.update(0.0 < builder.value("battery_voltage") < self._supply_min, now_ns),
            "engine_stalled": self._stalled.update(_stalled(state), now_ns),
            "tyre_flat": self._tyres.flat_s(now_ns),
        }

    def _on_the_bus(self, now_ns: int) -> dict[str, float]:
        """Who sends, and whether all arrives."""
        builder = self._builder
        return {
            "sender_doubled": _holds(builder.doubled),
            "foreign_emergency": _holds(builder.another("reports an emergency", now_ns)),
            "foreign_commands": _holds(builder.another("commands", now_ns)),
            "can_silence": builder.silence_s(now_ns),
            "counters_wrong": _holds(builder.counter_faults.level(now_ns) >= COUNTER_FAULT),
        }

    def _without_estimate(self, estimate: Latest[Estimate], now_ns: int) -> float:
        """Seconds without a valid estimate of a recent state."""
        age_s = 0.0 if estimate.message is None else (now_ns - estimate.message.state_stamp_ns) / NS_PER_S
        invalid = not usable(estimate, now_ns)
        held_s = self._estimate_invalid.update(invalid, now_ns)
        return max(held_s, age_s - ESTIMATE_MAX_S) if invalid else 0.0


def _comes_in(run: Latest[RunStatus], shown_s: float, now_ns: int) -> bool:
    """Whether the planner brings the car into its box under a black flag that has been shown for `shown_s`: its report
    is fresh and says so, or has not had the time to."""
    known = run.message if run.alive(now_ns) else None
    if known is None or known.box is None or known.phase is RunPhase.NONE:
        return False
    return known.phase in (RunPhase.IN_LAP, RunPhase.DONE) or shown_s <= run.deadline_s


def _requested(request: OperatorAction | None, state: VehicleState, comes_in: bool) -> dict[str, float]:
    """What operator and race control ask for; a black flag asks for no stop of a car that comes in."""
    stops = STOP_VEHICLE_FLAGS - {VehicleFlag.BLACK} if comes_in else STOP_VEHICLE_FLAGS
    return {
        **{measure: _holds(request is action) for action, measure in STOPPING_REQUESTS.items()},
        "vehicle_flag_kill": _holds(state.vehicle_flag in KILL_VEHICLE_FLAGS),
        "vehicle_flag_stop": _holds(state.vehicle_flag in stops),
        "track_flag_stop": _holds(state.track_flag in STOP_TRACK_FLAGS),
    }


def _holds(condition: bool) -> float:
    return HOLDS if condition else 0.0


def _obeys(state: VehicleState) -> bool:
    """Whether the car obeys brakes, and has said where the steering is that goes out with them."""
    steering = state.sources.get("steering")
    return state.sys_state in OBEYS_BRAKES and steering is not None and steering.age_s is not None


def _stalled(state: VehicleState) -> bool:
    """Whether the engine stands in a car that is driving."""
    powertrain = state.sources.get("powertrain")
    reported = powertrain is not None and powertrain.valid
    return reported and state.sys_state == SysState.DRIVING and state.engine_speed < ENGINE_TURNS


def _drives_on(state: VehicleState) -> bool:
    """Whether the car obeys commands and moves."""
    return state.sys_state == SysState.DRIVING and road_speed(state) > UNCOMMANDED
