"""What a person is told whose request was refused."""

from __future__ import annotations

from support.cars.car_messages import gateway_status

from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.cli.gateway import _why


def test_a_car_that_became_ready_after_it_was_asked_is_asked_again() -> None:
    cranked = {"action": FailsafeAction.SILENT, "cause": "", "missing_for_crank": ("ladder",)}
    ready = gateway_status(0, missing_for_arming=(), **cranked)
    assert "ask again" in _why(OperatorAction.ARM, ready)
    cranking = gateway_status(0, missing_for_arming=("car_not_driving",), **cranked)
    assert _why(OperatorAction.ARM, cranking).startswith("car_not_driving: ")
    assert "stays in silent" in _why(OperatorAction.STOP, ready)
