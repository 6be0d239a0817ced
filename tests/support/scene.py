"""A car at speed on the road course as the bus shows it, for the pages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hil_gateway.bus import messages as m
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.topics import (
    ALERT,
    BELIEF,
    ESTIMATE,
    GATEWAY_STATUS,
    PLAN,
    RACE_LINE,
    VEHICLE_STATE,
    Topic,
)
from hil_gateway.config import Config
from hil_gateway.dashboard.feed import Feed
from hil_gateway.track.loading import load_track

UNHEARD = replace(PLAN, key="av24/unheard")


class ListeningBus(LocalBus):
    """A bus on which publishing by the code under test would be seen."""

    def __init__(self) -> None:
        super().__init__()
        self.subscribed: list[str] = []

    def subscribe(self, topic: Topic[Any], depth: int = 1) -> Any:
        self.subscribed.append(topic.key)
        return super().subscribe(topic, depth)


def publish_scene(bus: LocalBus, now_ns: int, *, plan: bool = True) -> None:
    """A car at speed on the road course, with a belief, a plan and an alert."""
    track = load_track()
    x, y, yaw = (float(a[200]) for a in (track.x, track.y, track.heading))
    ahead = slice(200, 300, 5)
    bus.publish(
        ESTIMATE,
        m.Estimate(
            stamp_ns=now_ns, seq=1, state_stamp_ns=now_ns, valid=True, x=x, y=y, yaw=yaw, vx=61.5, vy=0.1, yaw_rate=0.2,
            bias_ax=0, bias_ay=0, bias_yaw_rate=0, std=(0.1,) * 9, steer=0.02, drive=0.01, innovations_rejected=0,
        ),
    )  # fmt: skip
    names = ("cx", "bf", "cf", "df", "br", "cr", "dr")
    mean = (52000.0, 9.4, 1.31, 1.42, 10.6, 1.38, 1.40)
    covariance = tuple(tuple((0.08 * a) ** 2 if i == j else 0.0 for j in range(7)) for i, a in enumerate(mean))
    bus.publish(
        BELIEF,
        m.Belief(
            stamp_ns=now_ns, seq=1, layout="per_axle", names=names, mean=mean, covariance=covariance,
            samples=4321, log_det_information=3.0,
        ),
    )  # fmt: skip
    xs, ys = tuple(map(float, track.x[ahead])), tuple(map(float, track.y[ahead]))
    zeros = (0.0,) * len(xs)
    bus.publish(
        PLAN if plan else UNHEARD,
        m.Plan(
            stamp_ns=now_ns, seq=1, state_stamp_ns=now_ns, status=m.PlanStatus.SOLVED, dt=0.05, x=xs, y=ys, yaw=zeros,
            vx=zeros, s=zeros, steer=zeros, drive=zeros, lap=3, revision="abc", solve_ms=12.5,
        ),
    )  # fmt: skip
    bus.publish(
        GATEWAY_STATUS,
        m.GatewayStatus(
            stamp_ns=now_ns, seq=1, mode="armed", armed=True, action=m.FailsafeAction.DRIVE, cause="",
            missing_for_arming=(), bus="socketcan vcan0", bus_state="error_active", frames_received=123456,
            frames_lost=0, frames_unknown=0, frames_malformed=0, counter_errors=0, commands_sent=98765,
            commands_limited=12, loop_latency_p50_ms=21.0, loop_latency_p99_ms=38.0,
        ),
    )  # fmt: skip
    alert = m.Alert(stamp_ns=now_ns, seq=1, channel="ay", condition="right turns above 40 m/s", strength=3.2)
    bus.publish(ALERT, alert)

    bus.publish(VEHICLE_STATE, vehicle_state(now_ns))
    bus.publish(RACE_LINE, race_line(now_ns, 70.0))


def race_line(now_ns: int, speed: float) -> RaceLine:
    """The centre line, driven at `speed` m/s except at its start."""
    track = load_track()
    x, y, s = (tuple(values[::8].tolist()) for values in (track.x, track.y, track.s))
    return RaceLine(
        stamp_ns=now_ns, seq=1, x=x, y=y, vx=(60.0, *(speed,) * (len(x) - 1)), track_s=s, clearance_m=1.5,
        lap_time_s=83.5,
    )  # fmt: skip


def vehicle_state(now_ns: int, report_age_s: float = 0.005) -> m.VehicleState:
    """A car at speed whose reports are that old."""
    numbers = dict.fromkeys(
        (
            "ax", "ay", "az", "yaw_rate", "roll_rate", "wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl",
            "wheel_speed_rr", "steer", "steer_rate", "accelerator", "throttle", "brake_front", "brake_rear", "drive",
            "engine_speed", "position_x", "position_y",
        ),
        0.0,
    )  # fmt: skip
    whole = dict.fromkeys(("gear", "position_seq", "sys_state", "ct_state", "track_flag", "vehicle_flag"), 1)
    sources = {"imu": m.SourceHealth(age_s=report_age_s, valid=True)}
    return m.VehicleState(stamp_ns=now_ns, seq=1, valid=True, sources=sources, **numbers, **whole)


def stop_event(now_ns: int, cause: str, after: str = "controlled_stop") -> Event:
    """The gateway has stopped the car."""
    return Event(
        stamp_ns=now_ns, seq=1, kind=EventKind.FAILSAFE, severity=Severity.STOP, before="drive", after=after,
        cause=cause, measured=0.11, limit=0.1, unit="s", text="no fresh planner command",
    )  # fmt: skip


def armed_event(now_ns: int) -> Event:
    """A person has armed the gateway."""
    info = Severity.INFO
    return Event(stamp_ns=now_ns, seq=2, kind=EventKind.ARMING, severity=info, before="silent", after="drive", text="x")


def feed_on(bus: LocalBus) -> Feed:
    return Feed(bus, load_track(), Config())
