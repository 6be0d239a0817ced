"""People are told which line the planner aims at."""

from __future__ import annotations

import numpy as np
import pytest

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import RACE_LINE
from planner.line.line_publisher import POINTS, LinePublisher
from planner.line.raceline import OptimisedLine

CLEARANCE = 1.4


def circle(n: int, speed: float = 40.0, radius: float = 500.0) -> OptimisedLine:
    angle = 2 * np.pi * np.arange(n) / n
    flat, length = np.zeros(n), 2 * np.pi * radius
    return OptimisedLine(
        s=radius * angle, x=radius * np.cos(angle), y=radius * np.sin(angle), heading=angle + np.pi / 2,
        curvature=np.full(n, 1 / radius), vx_profile=np.full(n, speed), width_left=flat + 5, width_right=flat + 5,
        grade=flat, bank=flat, bend=flat, track_s=radius * angle, length=length, lap_time=length / speed,
    )  # fmt: skip


def test_a_listener_that_comes_late_hears_the_line_within_a_period() -> None:
    bus = LocalBus()
    teller = LinePublisher(bus)
    teller.step(0, circle(800), CLEARANCE)
    late = bus.subscribe(RACE_LINE, depth=9)
    for now_ns in range(0, 2 * RACE_LINE.period_ns + 1, 50_000_000):
        teller.step(now_ns, circle(800), CLEARANCE)
    assert [message.stamp_ns for message in late.poll(0)] == [RACE_LINE.period_ns, 2 * RACE_LINE.period_ns]


def test_a_long_line_is_thinned_and_stays_the_same_line_within_the_topic_s_bound() -> None:
    bus = LocalBus()
    heard, line = bus.subscribe(RACE_LINE), circle(7919)
    LinePublisher(bus).step(0, line, CLEARANCE)
    (message,) = heard.poll(0)
    assert len(message.x) <= POINTS
    assert len(message.model_dump_json()) <= RACE_LINE.max_bytes
    assert np.hypot(message.x, message.y) == pytest.approx(500.0, abs=0.02)
    assert message.lap_time_s == pytest.approx(line.lap_time, abs=1e-3)
