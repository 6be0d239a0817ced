"""Whether a log may be used, by what the receiver says of its own solution. Pure.

Position and heading count only with integer ambiguities or their INS counterpart; with float ones they are degraded.
"""

from __future__ import annotations

import math
from enum import StrEnum

from hil_gateway.receiver.oem7 import FINE, ReceiverLog

NARROW_INT = 50
"""position type of a log that names none: it is not judged by it"""
FIXED = frozenset({48, 49, 50, 51, 56})
"""position types: L1, wide-lane and narrow-lane integers, RTK into the INS, INS with fixed RTK"""
FLOAT = frozenset({32, 33, 34, 35, 55})
"""float ambiguities, INS with float RTK"""
INS_GOOD = 3
"""INS_SOLUTION_GOOD; 2 is high variance, 6 runs without GNSS updates, 7 is aligned and waits for motion"""
SOLUTION_AGE_MAX_S = 1.0
"""older corrections or an older solution: what is sent is extrapolated"""


class Quality(StrEnum):
    """What a log is good for."""

    FIXED = "fixed"
    DEGRADED = "degraded"
    REFUSED = "refused"


def judge(log: ReceiverLog) -> tuple[Quality, str]:
    """Quality, and why it is not fixed."""
    if refusal := _refusal(log):
        return Quality.REFUSED, refusal
    values, kind = log.values, log.values.get("position_type", NARROW_INT)
    if max(values.get("differential_age_s", 0.0), values.get("solution_age_s", 0.0)) > SOLUTION_AGE_MAX_S:
        return Quality.DEGRADED, f"corrections older than {SOLUTION_AGE_MAX_S:g} s"
    return (Quality.DEGRADED, f"float (type {kind})") if kind in FLOAT else (Quality.FIXED, "")


def _refusal(log: ReceiverLog) -> str:
    values = log.values
    kind = values.get("position_type", NARROW_INT)
    if log.time_status < FINE:
        return f"clock of the receiver not set (time status {log.time_status})"
    if values.get("solution_status", 0) != 0:
        return f"no solution (status {values['solution_status']})"
    if values.get("ins_status", INS_GOOD) != INS_GOOD:
        return f"INS not ready (status {values['ins_status']})"
    if not all(math.isfinite(value) for value in values.values() if isinstance(value, float)):
        return "a value is not a number"
    return "" if kind in FIXED | FLOAT else f"no RTK (type {kind})"
