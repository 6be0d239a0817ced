"""When a period of the gateway begins, and when its command leaves: the time that an answer takes is mostly waiting.

A report that has just missed a period waits for the next one, and so does a command. Periods therefore begin shortly
after the car's reports have come, and commands leave so much later that estimator and planner have answered.
"""

from __future__ import annotations

from hil_gateway.process.clock import next_due
from hil_gateway.settings.gateway import PERIOD_NS

ANSWER_NS = 4_000_000
"""from the beginning of a period to its frames: state 0.8 ms, estimate 1.2 ms, plan 2.4 ms on two cores"""
LATEST_NS = 5_500_000
"""until which frames wait for a command that is due: frames leave every 10 ms within 2 ms"""
AFTER_REPORTS_NS = 1_000_000
"""from the newest report to the beginning of a period: reports come as irregularly as that"""
SLEW_NS = 20_000
"""by which a period may be longer or shorter: its place is found within 2.5 s, and counters keep to 0.2 % of 10 ms"""


def next_period(due_ns: int, now_ns: int, report_age_ns: int) -> int:
    """Beginning of the period after the one due at `due_ns`, in which the newest report was `report_age_ns` old."""
    return next_due(due_ns, now_ns, PERIOD_NS) - _too_late(report_age_ns)


def _too_late(report_age_ns: int) -> int:
    """By how much periods begin too late after the reports, ns, within `SLEW_NS`; negative: too early, so that reports
    wait for the whole of a period."""
    late_ns = (report_age_ns - AFTER_REPORTS_NS + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2
    return min(max(late_ns, -SLEW_NS), SLEW_NS)
