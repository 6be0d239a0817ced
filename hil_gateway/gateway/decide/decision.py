"""What the gateway decides in one period: failsafe first, then the ladder it demands. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.car.states import CtState, SysState
from hil_gateway.gateway.decide.failsafe import Failsafe, Inputs, WhileSilent, first_firing_while_silent
from hil_gateway.gateway.decide.race_control import Demand, LadderInputs, RaceControl


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything a decision depends on besides what was decided before."""

    now_ns: int
    conditions: Inputs
    ladder: LadderInputs
    highest: CtState = CtState.NOMINAL_RACE
    """rung the mode does not climb beyond"""


@dataclass(frozen=True, slots=True)
class Decision:
    """What is in force; `decide` returns the next one."""

    failsafe: Failsafe = field(default_factory=Failsafe)
    race_control: RaceControl = field(default_factory=RaceControl)
    restarting: bool = False
    """a person disarmed the standing car: the ladder starts over, and waits for the car to do so too"""
    silent_cause: str = ""
    """row that put the ladder into emergency while no commands were sent"""
    silent_ns: int = 0
    """when the failsafe was last silent"""

    @property
    def action(self) -> FailsafeAction:
        """The failsafe's."""
        return self.failsafe.action

    @property
    def cause(self) -> str:
        """Row of the failsafe table behind the stop, or behind the ladder's emergency."""
        emergency = self.race_control.ct_state is CtState.EMERGENCY
        return self.failsafe.cause or (self.silent_cause if emergency else "")

    @property
    def stopping(self) -> bool:
        """Whether the gateway is bringing the car to a stop, or holds it there."""
        return self.action in (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)


def decide(situation: Situation, state: Decision) -> Decision:
    """Next decision; never raises, whatever the inputs."""
    failsafe = state.failsafe.step(situation.conditions)
    restarting = _restarting(situation, state)
    row = first_firing_while_silent(situation.conditions)
    starting = restarting or state.race_control.ct_state <= CtState.INIT
    emergency = row is not None and not (row.while_silent is WhileSilent.BEYOND_INIT and starting)
    demand = Demand(
        stop=failsafe.action is FailsafeAction.CONTROLLED_STOP,
        emergency=failsafe.action is FailsafeAction.EMERGENCY_STOP or emergency,
        restart=restarting,
        armed=failsafe.action is FailsafeAction.DRIVE,
        highest=situation.highest,
    )
    return Decision(
        failsafe,
        state.race_control.step(situation.now_ns, situation.ladder, demand),
        restarting,
        _silent_cause(state, row.cause if row is not None and emergency else ""),
        state.silent_ns if state.failsafe.armed else situation.now_ns,
    )


def _silent_cause(state: Decision, cause: str) -> str:
    """The first cause of an emergency keeps its name: the car's own emergency follows from it."""
    if state.race_control.ct_state is CtState.EMERGENCY and state.silent_cause:
        return state.silent_cause
    return cause or state.silent_cause


def _restarting(situation: Situation, state: Decision) -> bool:
    """Whether both ladders begin anew: after a disarm the car misses our commands and goes into its own emergency."""
    if situation.conditions.request is OperatorAction.DISARM and situation.conditions.standing:
        return state.restarting or state.failsafe.armed or state.race_control.ct_state is CtState.EMERGENCY
    back = situation.ladder.car_alive and situation.ladder.sys_state <= SysState.CONNECTED
    return state.restarting and not back
