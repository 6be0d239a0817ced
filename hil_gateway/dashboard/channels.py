"""What the page's charts draw: one row a period, in the units people read; null where the source has fallen silent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from can_dbc.units import UNITS
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.topics import (
    APPLIED,
    BELIEF,
    COMMAND,
    ESTIMATE,
    GATEWAY_STATUS,
    PLAN,
    RACE_LINE,
    VEHICLE_STATE,
    Topic,
)
from hil_gateway.car.vehicle import GRAVITY, Vehicle

BAR, KPA, RPM = (UNITS[unit].factor for unit in ("bar", "kPa", "rpm"))
SLOWEST = 5.0
"""m/s; slower than this a slip angle is noise over noise"""


@dataclass(frozen=True)
class Channel:
    """One column of the history."""

    name: str
    topic: Topic[Any]
    value: Callable[[Any], float | None]
    digits: int = 2


CHANNELS: tuple[Channel, ...] = (
    Channel("x", ESTIMATE, lambda e: e.x),
    Channel("y", ESTIMATE, lambda e: e.y),
    Channel("yaw", ESTIMATE, lambda e: e.yaw, 3),
    Channel("speed", ESTIMATE, lambda e: e.vx),
    Channel("yaw_rate", ESTIMATE, lambda e: math.degrees(e.yaw_rate)),
    Channel("ax", VEHICLE_STATE, lambda v: v.ax / GRAVITY, 3),
    Channel("ay", VEHICLE_STATE, lambda v: v.ay / GRAVITY, 3),
    Channel("steer", VEHICLE_STATE, lambda v: math.degrees(v.steer)),
    Channel("steer_asked", COMMAND, lambda c: math.degrees(c.steer)),
    Channel("steer_sent", APPLIED, lambda a: math.degrees(a.steer) if a.sent else None),
    Channel("accelerator", VEHICLE_STATE, lambda v: 100.0 * v.accelerator, 1),
    Channel("accelerator_sent", APPLIED, lambda a: a.accelerator_percent if a.sent else None, 1),
    Channel("brake", VEHICLE_STATE, lambda v: v.brake_front / BAR, 1),
    Channel("brake_sent", APPLIED, lambda a: a.brake_front_kpa * KPA / BAR if a.sent else None, 1),
    Channel("residual_ax", BELIEF, lambda b: b.residual[0] if b.residual else None),
    Channel("residual_ay", BELIEF, lambda b: b.residual[1] if b.residual else None),
    Channel("gear", VEHICLE_STATE, lambda v: float(v.gear), 0),
    Channel("engine", VEHICLE_STATE, lambda v: v.engine_speed / RPM, 0),
    Channel("plan_ms", PLAN, lambda p: p.solve_ms),
    Channel("latency_ms", GATEWAY_STATUS, lambda g: g.loop_latency_p99_ms, 1),
)
"""speeds in m/s, angles in degrees, specific force in g, residuals in m/s2, pedals in % and bar, engine in 1/min,
positions in m"""
DERIVED = ("s", "slip_front", "slip_rear", "delta", "line_speed", "grip")
"""columns of more than one message: position along the track (m), slip angles (deg), delta to the best lap (s), speed
the planner asks for at this place (m/s), grip used (%)"""
FRICTION = frozenset({"d", "df", "dr"})
"""tyre parameters that are a friction coefficient"""


def row_of(messages: Mapping[str, Any]) -> dict[str, float | None]:
    """One row from the newest messages that are alive, by topic key."""
    row: dict[str, float | None] = {}
    for channel in CHANNELS:
        message = messages.get(channel.topic.key)
        value = None if message is None else channel.value(message)
        row[channel.name] = None if value is None else round(value, channel.digits)
    return row


def slip_angles(messages: Mapping[str, Any], vehicle: Vehicle) -> tuple[float | None, float | None]:
    """Front and rear slip angle, deg, positive where the lateral force is to the left."""
    e, v = messages.get(ESTIMATE.key), messages.get(VEHICLE_STATE.key)
    if e is None or v is None or e.vx < SLOWEST:
        return None, None
    front = v.steer - math.atan2(e.vy + vehicle.lf * e.yaw_rate, e.vx)
    rear = -math.atan2(e.vy - vehicle.lr * e.yaw_rate, e.vx)
    return round(math.degrees(front), 3), round(math.degrees(rear), 3)


def grip_used(messages: Mapping[str, Any], vehicle: Vehicle) -> float | None:
    """Measured specific force over what the weaker axle is believed to hold with the declared downforce, %."""
    e, v, belief = (messages.get(topic.key) for topic in (ESTIMATE, VEHICLE_STATE, BELIEF))
    if e is None or v is None or belief is None:
        return None
    friction = [mean for name, mean in zip(belief.names, belief.mean, strict=True) if name in FRICTION]
    held = min(friction, default=0.0) * (GRAVITY + vehicle.downforce(e.vx) / vehicle.mass)
    return round(100.0 * math.hypot(v.ax, v.ay) / held, 1) if held > 0 else None


def asked_speed(messages: Mapping[str, Any], along: float, length: float) -> float | None:
    """Speed of the race line at `along` m of a track of `length` m, m/s."""
    line: RaceLine | None = messages.get(RACE_LINE.key)
    if line is None or not line.x:
        return None
    return round(float(np.interp(along, line.track_s, line.vx, period=length)), 2)
