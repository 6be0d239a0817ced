"""What the gateway decides in one period: failsafe first, then the ladder it demands. Pure."""

from __future__ import annotations

from typing import NamedTuple

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.car.states import CtState, SysState
from hil_gateway.gateway.decide.failsafe import Failsafe, Inputs, WhileSilent, first_firing_while_silent
from hil_gateway.gateway.decide.race_control import Demand, LadderInputs, RaceControl
from hil_gateway.process.clock import NS_PER_S

STOPS = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)
KILL = "vehicle_flag_kill"
EXPLAINED_S = 0.25
"""s after the car's emergency within which an e-kill explains it: the car obeys the flag at once, and repeats it to the
computer ten times a second"""
NOTICED_S = 0.5
"""s after which a car that supervises its commands has noticed their end (it takes 0.2 s), and has said so"""


class Situation(NamedTuple):
    """Everything a decision depends on besides what was decided before."""

    now_ns: int
    conditions: Inputs
    ladder: LadderInputs
    highest: CtState = CtState.NOMINAL_RACE
    """rung the mode does not climb beyond"""
    sends: bool = True
    """the mode sends frames: what climbs its ladder cranks an engine"""
    may_hold: bool = False
    """the car would obey brakes, they are to hold it, and no other computer commands it"""


class Decision(NamedTuple):
    """What is in force; `decide` returns the next one."""

    failsafe: Failsafe = Failsafe()
    race_control: RaceControl = RaceControl()
    restarting: bool = False
    """the ladder starts over, and waits for the car to do so too"""
    silent_cause: str = ""
    """row that put the ladder into emergency while no commands were sent"""
    silent_ns: int = 0
    """when the failsafe was last silent"""
    calm_ns: int = 0
    """when the ladder was last not in emergency"""
    holding: bool = False
    """brakes alone are commanded, unarmed"""
    commanded_ns: int | None = None
    """when actuators were last commanded"""

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
        return self.action in STOPS


def decide(situation: Situation, state: Decision) -> Decision:
    """Next decision; never raises, whatever the inputs."""
    failsafe = _explained(situation, state)
    restarting = _restarting(situation, state)
    holding = situation.may_hold and not failsafe.armed and not restarting
    row = first_firing_while_silent(situation.conditions)
    starting = restarting or state.race_control.ct_state <= CtState.INIT
    emergency = row is not None and not (row.while_silent is WhileSilent.BEYOND_INIT and starting)
    demand = Demand(
        stop=failsafe.action in STOPS,
        emergency=failsafe.engine_off or emergency,
        restart=restarting,
        armed=failsafe.action is FailsafeAction.DRIVE,
        highest=situation.highest,
        crank=situation.conditions.request is OperatorAction.CRANK or not situation.sends,
    )
    race_control = state.race_control.step(situation.now_ns, situation.ladder, demand)
    return Decision(
        failsafe,
        race_control,
        restarting,
        _silent_cause(situation, state, row.cause if row is not None and emergency else ""),
        silent_ns=state.silent_ns if state.failsafe.armed else situation.now_ns,
        calm_ns=state.calm_ns if race_control.ct_state is CtState.EMERGENCY else situation.now_ns,
        holding=holding,
        commanded_ns=situation.now_ns if failsafe.armed or holding else state.commanded_ns,
    )


def _explained(situation: Situation, state: Decision) -> Failsafe:
    """Next state of the failsafe; an emergency of the car that an e-kill has caused is named for it."""
    failsafe = state.failsafe.step(situation.conditions)
    return failsafe._replace(cause=KILL) if _killed(situation, state, failsafe.cause) else failsafe


def _killed(situation: Situation, state: Decision, cause: str) -> bool:
    fires = situation.conditions.measures.get(KILL, 0.0) > 0.0
    return fires and cause == "car_emergency" and situation.now_ns - state.calm_ns <= EXPLAINED_S * NS_PER_S


def _silent_cause(situation: Situation, state: Decision, cause: str) -> str:
    """The first cause of an emergency keeps its name: the car's own emergency follows from it."""
    if state.race_control.ct_state is not CtState.EMERGENCY or not state.silent_cause:
        return cause or state.silent_cause
    return KILL if _killed(situation, state, state.silent_cause) else state.silent_cause


def _restarting(situation: Situation, state: Decision) -> bool:
    """Whether both ladders begin anew: a person disarms the standing car after an emergency, or so that commands end
    which the car supervises; or the car has begun anew. A car that has lost its power is back before it has noticed
    that commands end, and would then go into its emergency.
    """
    ct_state, armed = state.race_control.ct_state, state.failsafe.armed
    if situation.conditions.request is OperatorAction.DISARM and situation.conditions.standing:
        return state.restarting or ct_state is CtState.EMERGENCY or (armed and not situation.may_hold)
    if not (situation.ladder.car_alive and situation.ladder.sys_state <= SysState.CONNECTED):
        return state.restarting
    reached = SysState.TEST_DONE if ct_state is CtState.CRANK_READY else SysState.CRANK_READY
    # a ladder may lack the rung of the test
    left = not situation.ladder.has_reached(situation.ladder.sys_state, reached)
    began = left and not armed and CtState.ACTUATOR_TEST < ct_state < CtState.EMERGENCY
    noticed = state.commanded_ns is None or situation.now_ns - state.commanded_ns > NOTICED_S * NS_PER_S
    return began or (state.restarting and not noticed)
