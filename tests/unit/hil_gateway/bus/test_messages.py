"""What a message must be to be believed: lengths that fit, integers that mean something."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from hil_gateway.bus.messages import Belief, Command, Message, ModelRevision, Plan

PLAN: dict[str, Any] = {
    "stamp_ns": 1, "seq": 1, "state_stamp_ns": 1, "status": "solved", "dt": 0.05, "lap": 0, "revision": "r",
    "solve_ms": 1.0, **dict.fromkeys(("x", "y", "yaw", "vx", "s", "steer", "drive"), (0.0, 0.0)),
}  # fmt: skip
BELIEF: dict[str, Any] = {
    "stamp_ns": 1, "seq": 1, "layout": "shared", "names": ("a", "b"), "mean": (1.0, 2.0),
    "covariance": ((1.0, 0.0), (0.0, 1.0)), "samples": 0, "log_det_information": 0.0,
}  # fmt: skip
COMMAND: dict[str, Any] = {"stamp_ns": 1, "seq": 1, "source": "p", "state_stamp_ns": 1, "steer": 0.0, "drive": 0.0}
REVISION: dict[str, Any] = {"stamp_ns": 1, "seq": 1, "revision": "r", "layout": "shared", "tyre": {"cx": 1.0}}


@pytest.mark.parametrize(
    ("kind", "good", "change"),
    [
        (Plan, PLAN, {"y": (0.0,)}),
        (Plan, PLAN, {"x": (0.0, 1e300)}),
        (Plan, PLAN, {"dt": 0.0}),
        (Plan, PLAN, {"lap": 10**400}),
        (Belief, BELIEF, {"mean": (1.0,)}),
        (Belief, BELIEF, {"covariance": ((1.0, 0.0), (0.0,))}),
        (Belief, BELIEF, {"covariance": ((1.0, 0.0),)}),
        (Belief, BELIEF, {"covariance": ((1e300, 0.0), (0.0, 1.0))}),
        (Command, COMMAND, {"stamp_ns": -1}),
        (Command, COMMAND, {"state_stamp_ns": 10**400}),
        (Command, COMMAND, {"seq": 1 << 63}),
        (ModelRevision, REVISION, {"covariance": ((1.0,), (1.0,))}),
        (ModelRevision, REVISION, {"tyre": {"cx": 1e300}}),
    ],
)
def test_what_does_not_fit_together_or_means_nothing_is_refused(
    kind: type[Message], good: dict[str, Any], change: dict[str, Any]
) -> None:
    kind.model_validate(good)
    with pytest.raises(ValidationError):
        kind.model_validate({**good, **change})
