"""Made-up traffic of a car for the tests of the bring-up check."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from can_dbc.codec import load_codec
from hil_gateway.can_link import Frame, LinkStats
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.gateway.check.finding import Finding, Verdict
from hil_gateway.gateway.check.report import Report
from hil_gateway.gateway.check.run import Capture, examine
from hil_gateway.process.clock import NS_PER_S

CODEC = load_codec()
SECONDS = 2.0
Values = dict[str, float]
Change = Callable[[str, float, Values], Values]


def at_rest(name: str, t: float, rng: np.random.Generator) -> Values:
    """What the car says standing still with the engine off, SI."""
    values = dict.fromkeys((signal.si_name for signal in CODEC.messages[name].signals), 0.0)
    known = {
        "imu_ax": 0.02 * rng.standard_normal(), "imu_ay": 0.02 * rng.standard_normal(),
        "imu_az": GRAVITY + 0.02 * rng.standard_normal(), "imu_yaw_rate": 0.002 * rng.standard_normal(),
        "imu_roll_rate": 0.002 * rng.standard_normal(), "battery_voltage": 13.2, "sys_state": 2,
        "novatel_lat": math.radians(36.585), "novatel_long": math.radians(-121.7535),
        "base_to_car_heartbeat": int(t * 10) % 16,
    }  # fmt: skip
    return values | {signal: value for signal, value in known.items() if signal in values}


def traffic(change: Change = lambda name, t, values: values) -> list[Frame]:
    """`SECONDS` of every message of the car at its period; `change` edits the values of a frame."""
    rng = np.random.default_rng(3)
    frames = []
    for message in CODEC.messages.values():
        if message.direction == "computer":
            continue
        for index in range(int(SECONDS / message.period_s)):
            t = index * message.period_s
            values = at_rest(message.name, t, rng)
            if message.counter:
                values[message.counter.signal] = index % message.counter.modulus
            frame_id, data = CODEC.encode(message.name, change(message.name, t, values))
            frames.append(Frame(frame_id, data, int(t * NS_PER_S)))
    return sorted(frames, key=lambda frame: frame.stamp_ns)


def report(frames: list[Frame], stats: LinkStats | None = None) -> Report:
    heard = Capture(frames, 0, int(SECONDS * NS_PER_S), 0.001, stats or LinkStats())
    return examine(Config(), "wire", None, heard)


def finding(result: Report, name: str) -> Finding:
    (match,) = [item for item in result.findings if item.name == name]
    return match


def trouble(result: Report) -> set[str]:
    """Names of everything that is not fine."""
    rows = {row.name for row in result.messages if row.verdict in (Verdict.WARN, Verdict.FAIL)}
    return rows | {item.name for item in result.findings if item.verdict in (Verdict.WARN, Verdict.FAIL)}


def edit(target: str, **fixed: float) -> Change:
    return lambda name, t, values: values | fixed if name == target else values
