"""Whether a log may be used, by what the receiver says of its own solution. Pure.

Position and heading count only with integer ambiguities or their INS counterpart; with float ones they are degraded,
and so is an inertial solution without corrections: its velocity stays good.
"""

from __future__ import annotations

import math

from hil_gateway.bus.outside import Quality
from hil_gateway.receiver.nmea import Sentence
from hil_gateway.receiver.oem7 import FINE, ReceiverLog

FIXED = frozenset({48, 49, 50, 51, 56})
"""position types: L1, wide-lane and narrow-lane integers, RTK into the INS, INS with fixed RTK"""
FLOAT = frozenset({32, 33, 34, 35, 55})
"""float ambiguities, INS with float RTK"""
INS_GOOD = 3
"""INS_SOLUTION_GOOD; 2 is high variance, 6 runs without GNSS updates, 7 is aligned and waits for motion"""
AGE_MAX_S = 1.0
"""of corrections and of a solution: older, what is sent is extrapolated; of a velocity receivers state 0 to 0.25 s"""


def judge(log: ReceiverLog) -> tuple[Quality, str]:
    """Quality, and why it is not fixed."""
    if refusal := _refusal(log):
        return Quality.REFUSED, refusal
    values, kind = log.values, log.values.get("position_type")
    if max(values.get("differential_age_s", 0.0), values.get("solution_age_s", 0.0)) > AGE_MAX_S:
        return Quality.DEGRADED, f"corrections older than {AGE_MAX_S:g} s"
    if kind is not None and kind not in FIXED | FLOAT:
        return Quality.DEGRADED if "ins_status" in values else Quality.REFUSED, f"no RTK (type {kind})"
    return (Quality.DEGRADED, f"float (type {kind})") if kind in FLOAT else (Quality.FIXED, "")


RTK_FIXED, RTK_FLOAT = 4, 5
"""quality of a GGA sentence"""


def judge_sentence(sentence: Sentence) -> tuple[Quality, str]:
    """The same of an NMEA sentence."""
    if sentence.kind == "GGA":
        if sentence.quality in (RTK_FIXED, RTK_FLOAT) and None not in (sentence.latitude, sentence.longitude):
            fixed = sentence.quality == RTK_FIXED
            return (Quality.FIXED, "") if fixed else (Quality.DEGRADED, f"float (quality {RTK_FLOAT})")
        return Quality.REFUSED, f"no RTK (quality {sentence.quality})"
    says = sentence.heading is not None if sentence.kind == "HDT" else sentence.quality == 1
    return (Quality.FIXED, "") if says else (Quality.REFUSED, "no solution")


def _refusal(log: ReceiverLog) -> str:
    values = log.values
    if log.time_status < FINE:
        return f"clock of the receiver not set (time status {log.time_status})"
    if values.get("solution_status", 0) != 0:
        return f"no solution (status {values['solution_status']})"
    if values.get("ins_status", INS_GOOD) != INS_GOOD:
        return f"INS not ready (status {values['ins_status']})"
    if not all(math.isfinite(value) for value in values.values() if isinstance(value, float)):
        return "a value is not a number"
    if not 0.0 <= values.get("latency_s", 0.0) <= AGE_MAX_S:
        return "latency of the velocity out of range"
    return ""
