"""What a person can ask of the gateway: the one table that inbox, failsafe and command line follow.

A new request is its name in `OperatorAction`, its row here, and what it does: a row of the failsafe table where it
stops the car, else the decision that looks for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hil_gateway.bus.messages import FailsafeAction, GatewayStatus, OperatorAction


@dataclass(frozen=True)
class Request:
    """One row."""

    meaning: str
    """help of `hil gateway NAME`"""
    reaches: tuple[FailsafeAction, ...]
    """what the gateway does once it has done what was asked"""
    once: bool = False
    """a second delivery is not taken: the request starts something"""
    stops: bool = False
    """the failsafe table has a row `operator_NAME`"""

    def done(self, status: GatewayStatus, before: GatewayStatus) -> bool:
        """Whether the gateway, which was at `before`, has done what was asked of it."""
        return status.action in self.reaches

    def answer(self, status: GatewayStatus) -> str:
        """What is said when it has."""
        return f"{status.action.value}{': ' + status.cause if status.cause else ''}"


class _Crank(Request):
    """Done when the ladder is beyond it."""

    def done(self, status: GatewayStatus, before: GatewayStatus) -> bool:
        return "cranked" in status.missing_for_crank

    def answer(self, status: GatewayStatus) -> str:
        return "cranked"


class _TakeOver(Request):
    """Done when the sender that was refused has the right."""

    def done(self, status: GatewayStatus, before: GatewayStatus) -> bool:
        return before.second_source not in ("", before.command_source) and status.command_source == before.second_source

    def answer(self, status: GatewayStatus) -> str:
        return f"{status.command_source} has the right to command"


_SILENT, _STOP, _EMERGENCY = FailsafeAction.SILENT, FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP

REQUESTS: Mapping[OperatorAction, Request] = {
    OperatorAction.EMERGENCY: Request("Emergency stop; latches.", (_EMERGENCY, _SILENT), stops=True),
    OperatorAction.STOP: Request("Controlled stop; latches.", (_STOP, _EMERGENCY, _SILENT), stops=True),
    OperatorAction.DISARM: Request(
        "No longer drive the car. At once when standing, after a controlled stop when moving.", (_SILENT, _STOP)
    ),
    OperatorAction.ARM: Request(
        "Ask the gateway to drive the car. Says what is missing when it refuses.", (FailsafeAction.DRIVE,), once=True
    ),
    OperatorAction.CRANK: _Crank(
        "Ask for the engine. Nothing cranks without this request, once for every start of the gateway and emergency.",
        (),
        once=True,
    ),
    OperatorAction.TAKE_OVER: _TakeOver(
        "Give the right to command to the source that is refused, without a stop: the other planner's, or a node's.",
        (),
        once=True,
    ),
}
"""Most urgent first: which counts when several arrive in one period."""
