"""The operator: cranks and arms once when the gateway has what it needs, and stops the car when told to give up."""

from __future__ import annotations

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import FailsafeAction, GatewayStatus, OperatorAction, OperatorCommand
from hil_gateway.bus.topics import OPERATOR
from hil_gateway.process.clock import NS_PER_S

REPEAT_NS = NS_PER_S // 2
STEADY_NS = NS_PER_S
"""nothing has been missing for so long: compilation and the first plans are over, and do not count against the drive"""


class Operator:
    """Never cranks or arms again after the gateway has stopped the car: that is for a person to decide."""

    def __init__(self, bus: Bus, asks: bool = True) -> None:
        """`asks`: else a person does, and this one only watches."""
        self._bus, self._asks = bus, asks
        self._seq = 0
        self._next_ns = 0
        self._ready_ns: int | None = None
        self.driving = False
        """the car has been under way"""

    def update(self, status: GatewayStatus | None, now_ns: int) -> None:
        """Crank, and arm when nothing has been missing for `STEADY_NS`, every `REPEAT_NS` until it is done."""
        if status is None:
            return
        self.driving = self.driving or status.action is FailsafeAction.DRIVE
        if status.missing_for_arming:
            self._ready_ns = None
        elif self._ready_ns is None:
            self._ready_ns = now_ns
        steady = self._ready_ns is not None and now_ns >= self._ready_ns + STEADY_NS
        action = OperatorAction.ARM if steady else None if status.missing_for_crank else OperatorAction.CRANK
        if self._asks and action is not None and not self.driving and now_ns >= self._next_ns:
            self._next_ns = now_ns + REPEAT_NS
            self.ask(action, now_ns)

    def ask(self, action: OperatorAction, now_ns: int) -> None:
        """Send one request to the gateway."""
        self._seq += 1
        self._bus.publish(OPERATOR, OperatorCommand(stamp_ns=now_ns, seq=self._seq, source="operator", action=action))
