"""The vehicle controller's side: sys_state ladder, command supervision, and what the actuators get in each state.

The states and who moves first are described in docs/failsafe.md. Pure: time is an argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from hil_gateway.plant.car import Commands
from hil_gateway.process.clock import NS_PER_S

AT_REST = Commands()
COMMAND_TIMEOUT_S = 0.2
"""a command counter that stands still for longer puts the car into EMERGENCY"""
PARKED = Commands(brake_front=1.0e6, brake_rear=1.0e6)
"""what the car does by itself below `DRIVING`"""
EMERGENCY_BRAKE_PA = 3.0e6
MARELLI_KILL = (32, 33)
"""vehicle flags purple and e-kill: the car obeys them by itself"""


class CarState(IntEnum):
    """What the car reports in `misc_report`."""

    POWER_ON = 1
    CONNECTED = 2
    TESTING = 3
    TEST_DONE = 4
    CRANK_READY = 5
    PRE_CRANK = 6
    CRANKING = 7
    IDLE = 8
    DRIVING = 9
    SHUT_ENGINE = 10
    EMERGENCY = 16
    CRITICAL_LIMIT = 18


CLIMB: dict[CarState, tuple[int, float, CarState]] = {
    CarState.POWER_ON: (0, 0.3, CarState.CONNECTED),
    CarState.CONNECTED: (3, 0.0, CarState.TESTING),
    CarState.TESTING: (3, 0.3, CarState.TEST_DONE),
    CarState.TEST_DONE: (4, 0.0, CarState.CRANK_READY),
    CarState.CRANK_READY: (5, 0.0, CarState.PRE_CRANK),
    CarState.PRE_CRANK: (5, 0.2, CarState.CRANKING),
    CarState.CRANKING: (5, 0.8, CarState.IDLE),
    CarState.IDLE: (7, 0.0, CarState.DRIVING),
}
"""state -> (least ct_state that lets it move on, least time in it (s), next state)"""


@dataclass(slots=True)
class ReceivedCommand:
    """What the computer said last."""

    ct_state: int = 0
    commands: Commands = AT_REST
    counters_ns: tuple[int, ...] | None = None
    """when each command counter last advanced; None before the first command of all"""


class VehicleController:
    """sys_state and its timing."""

    def __init__(self) -> None:
        self.state = CarState.POWER_ON
        self.cause = ""
        self._entered_ns: int | None = None

    @property
    def engine_running(self) -> bool:
        """Whether the engine turns."""
        return self.state in (CarState.IDLE, CarState.DRIVING)

    def step(self, now_ns: int, received: ReceivedCommand, standing: bool) -> None:
        """Move at most one rung."""
        if self._entered_ns is None:
            self._entered_ns = now_ns
        following = self._next(now_ns, received, standing, (now_ns - self._entered_ns) / NS_PER_S)
        if following is not self.state:
            self.state, self._entered_ns = following, now_ns

    def _next(self, now_ns: int, received: ReceivedCommand, standing: bool, in_state_s: float) -> CarState:
        if self.state is CarState.EMERGENCY:
            return CarState.CONNECTED if standing and received.ct_state in (1, 2) else self.state
        if received.ct_state == 12 and self.state > CarState.CONNECTED:
            self.cause = "ct_state emergency"
            return CarState.EMERGENCY
        if self.silent(now_ns, received):
            self.cause = "commands silent"
            return CarState.EMERGENCY
        if received.ct_state == 11:
            return CarState.SHUT_ENGINE
        if self.state is CarState.SHUT_ENGINE:
            return CarState.CONNECTED if standing and received.ct_state in (1, 2) else self.state
        least, pause_s, following = CLIMB.get(self.state, (99, 0.0, self.state))
        return following if least <= received.ct_state <= 10 and in_state_s >= pause_s else self.state

    def kill(self, cause: str) -> None:
        """Race control stops the car by itself."""
        if self.state is not CarState.EMERGENCY:
            self.state, self.cause, self._entered_ns = CarState.EMERGENCY, cause, None

    @staticmethod
    def silent(now_ns: int, received: ReceivedCommand) -> bool:
        """Whether commands were received once and a counter has stood still for too long."""
        return received.counters_ns is not None and now_ns - min(received.counters_ns) > COMMAND_TIMEOUT_S * NS_PER_S

    def obeyed(self, now_ns: int, received: ReceivedCommand) -> Commands:
        """What the actuators get."""
        asked = received.commands
        if self.state is CarState.DRIVING:
            return asked
        if self.state is not CarState.EMERGENCY:
            return PARKED
        if received.counters_ns is not None and not self.silent(now_ns, received):
            return Commands(asked.steer, 0.0, asked.brake_front, asked.brake_rear, 0)
        return Commands(asked.steer, 0.0, EMERGENCY_BRAKE_PA, EMERGENCY_BRAKE_PA, 0)
