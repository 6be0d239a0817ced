"""What every process does the same way."""

from __future__ import annotations

import pytest

from hil_gateway.process.lifecycle import SilenceNotice

S = 1_000_000_000


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records]


def test_a_bus_that_stays_silent_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    notice = SilenceNotice("estimate", ("tcp/10.0.0.9:7448",), now_ns=S)
    for k in range(20):
        notice.step(S + k * S, received=False)
    assert said(caplog) == ["no estimate yet through tcp/10.0.0.9:7448 (zenoh.connect)"]


def test_who_has_heard_something_is_not_told_when_it_ends(caplog: pytest.LogCaptureFixture) -> None:
    notice = SilenceNotice("estimate", (), now_ns=0)
    notice.step(S, received=True)
    notice.step(100 * S, received=False)
    assert said(caplog) == []
