"""A car, a race control, an estimator and a planner that do as they are told: the gateway's world in its tests.

Deterministic and without physics beyond one integrator, so that a test says exactly what happens and when.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from benchmarks.promises.wire_judge import other_than_brakes
from can_dbc.codec import load_codec
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import (
    Applied,
    Command,
    Estimate,
    FailsafeAction,
    GatewayStatus,
    Lacks,
    OperatorAction,
    OperatorCommand,
    Plan,
    PlanStatus,
    VehicleState,
)
from hil_gateway.can_link import Frame, VirtualWire
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.gateway.core import Gateway
from hil_gateway.process.clock import NS_PER_S, VirtualClock
from hil_gateway.track.geodesy import LocalMap

PERIOD_NS = NS_PER_S // 100
MAP = LocalMap(Config().origin)
ACTUATOR_IDS = frozenset({0x578, 0x579, 0x57A, 0x57B})
REPORTS = (
    "imu_1", "imu_2", "imu_3", "wheel_speed_report", "steering_report", "steering_report_extd", "accelerator_report",
    "brake_pressure_report", "pt_report_1", "misc_report", "diagnostic_report", "steering_report_extd_2",
)  # fmt: skip


@dataclass
class ScriptedCar:
    """Answers the ladder and integrates its speed; every attribute may be overwritten by a test."""

    link: object
    speed: float = 0.0
    x: float = 0.0
    sys_state: int = 1
    track_flag: int = 1
    vehicle_flag: int = 0
    marelli_vehicle_flag: int = 0
    heartbeat_runs: bool = True
    reports: bool = True
    muted: set[str] = field(default_factory=set)
    frozen_counters: bool = False
    overrides: dict[str, float] = field(default_factory=dict)
    commands: dict[str, float] = field(default_factory=dict)
    heard: list[tuple[int, Frame]] = field(default_factory=list)
    ct_state: int = 0
    tick: int = 0
    command_tick: int | None = None
    supervised: bool = True
    pushed: float = 0.0

    def step(self, now_ns: int) -> None:
        """Listen, answer, move, report."""
        codec = load_codec()
        for frame in self.link.receive():
            self.heard.append((now_ns, frame))
            values = codec.decode_raw(frame.id, frame.data)
            self.commands.update(values)
            if frame.id in ACTUATOR_IDS:
                self.command_tick = self.tick
            if frame.id == 0x57C:
                self.ct_state = int(values["ct_state"])
        self._climb()
        self._move(PERIOD_NS / NS_PER_S)
        if self.reports:
            self._report()
        self.tick += 1

    def _climb(self) -> None:
        """As the car: 200 ms without a command after the first one, and ct_state 12, are an emergency."""
        if self.sys_state == 16 and not (self.ct_state in (1, 2) and self.speed == 0):
            return
        if self.sys_state == 16:
            self.command_tick = None
        if self.command_tick is not None and self.tick - self.command_tick > 20 and self.supervised:
            self.sys_state = 16
            return
        if self.sys_state == 9 and self.ct_state < 7:
            return
        reached = {1: 2, 2: 2, 3: 4, 4: 5, 5: 8, 6: 8, 7: 9, 8: 9, 9: 9, 10: 9, 11: 10, 12: 16}
        self.sys_state = reached.get(self.ct_state, self.sys_state)

    def _move(self, dt: float) -> None:
        driving = self.sys_state == 9
        push = 0.06 * self.commands.get("acc_pedal_cmd", 0.0) if driving else 0.0
        brake = 0.0025 * self.commands.get("F_brake_pressure_cmd", 0.0)
        self.speed = max(self.speed + (push - brake) * dt, 0.0)
        self.pushed = push - brake if self.speed > 0.0 else 0.0
        self.x += self.speed * dt

    def signals(self) -> dict[str, float]:
        """Every report signal in DBC units; what is not named is 0."""
        wheel = self.speed * 3.6
        steer = self.commands.get("steering_motor_ang_cmd", 0.0)
        jitter = 0.02 * math.sin(1.7 * self.tick)
        latitude, longitude = MAP.to_geodetic(self.x, 0.0)
        return {
            "imu_az": 1.0 + jitter, "imu_ax": self.pushed / GRAVITY + jitter, "imu_ay": -jitter,
            "imu_yaw_rate": 5 * jitter,
            "imu_roll_rate": 5 * jitter,
            "wheel_speed_FL": wheel, "wheel_speed_FR": wheel, "wheel_speed_RL": wheel, "wheel_speed_RR": wheel,
            "primary_steering_angle_fbk": steer, "secondary_steering_ang_fdbk": steer,
            "average_steering_ang_fdbk": steer,
            "acc_pedal_fdbk": max(self.commands.get("acc_pedal_cmd", 0.0), 0.0),
            "brake_pressure_fdbk_front": self.commands.get("F_brake_pressure_cmd", 0.0),
            "brake_pressure_fdbk_rear": self.commands.get("R_brake_pressure_cmd", 0.0),
            "current_gear": max(self.commands.get("desired_gear", 1.0), 1.0), "engine_speed_rpm": 3000.0,
            "battery_voltage": 13.0, "sys_state": self.sys_state, "mode_switch_state": 1,
            "track_flag": self.track_flag, "veh_flag": self.vehicle_flag,
            "base_to_car_heartbeat": (self.tick // 10) % 16,
            "marelli_track_flag": self.track_flag, "marelli_vehicle_flag": self.marelli_vehicle_flag,
            "novatel_lat": latitude, "novatel_long": longitude,
        } | self.overrides  # fmt: skip

    def _report(self) -> None:
        values = self.signals()
        names = list(REPORTS)
        names += ["novatel_report"] if self.tick % 5 == 0 else []
        if self.tick % 10 == 0:
            names += (["base_to_car_summary"] if self.heartbeat_runs else []) + ["marelli_report_1"]
        for name in names:
            if name not in self.muted:
                self.send(name, values)

    def send(self, name: str, values: dict[str, float]) -> None:
        """Send one report with its counter."""
        codec = load_codec()
        layout = codec.messages[name]
        content = {signal: values.get(signal, 0.0) for signal in layout.signal}
        if layout.counter is not None:
            content[layout.counter.signal] = 0 if self.frozen_counters else self.tick % layout.counter.modulus
        self.link.send(*codec.encode_raw(name, content))


class Rig:
    """Gateway and scripted world on one virtual clock, 100 Hz."""

    def __init__(self, config: Config | None = None, start_ns: int = NS_PER_S) -> None:
        self.clock = VirtualClock(start_ns)
        self.bus = LocalBus()
        self.wire = VirtualWire(self.clock)
        self.car = ScriptedCar(self.wire.link())
        self.gateway = Gateway(config or Config(), self.bus, self.wire.link())
        self.states = self.bus.subscribe(topics.VEHICLE_STATE)
        self.applied_in = self.bus.subscribe(topics.APPLIED)
        self.status_in = self.bus.subscribe(topics.GATEWAY_STATUS)
        self.applied: list[Applied] = []
        self.status: GatewayStatus | None = None
        self.seq = self.tick = 0
        self.steer = 0.0
        self.brake_balance: float | None = None
        self.drive = 0.02
        self.planner_runs = True
        self.publishes_plans = True
        self.estimator_runs = True
        self.estimate_valid = True
        self.lacks: Lacks = ""
        self.aside = 0.0
        """m by which the estimate lies beside the fixes"""
        self.plan_changes: dict[str, object] = {}
        self.gateway_runs = True
        self.person_cranks = True
        self.hooks: list[Callable[[Rig], None]] = []

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns()

    @property
    def action(self) -> FailsafeAction:
        return self.gateway.failsafe.action

    @property
    def cause(self) -> str:
        return self.gateway.failsafe.cause

    def frames(self, since_ns: int = 0, ids: frozenset[int] = ACTUATOR_IDS) -> list[tuple[int, Frame]]:
        """Frames of the gateway heard by the car since a time."""
        return [(stamp, frame) for stamp, frame in self.car.heard if stamp >= since_ns and frame.id in ids]

    def other_than_brakes(self) -> list[str]:
        """What the actuators were asked for beside the brakes that hold the car."""
        return other_than_brakes((frame.id, frame.data) for _, frame in self.frames())

    def step(self) -> None:
        """One period: car, gateway, estimator, planner."""
        self.car.step(self.now_ns)
        if self.gateway_runs:
            self.gateway.step(self.now_ns)
        self.applied += self.applied_in.poll(self.now_ns)
        for status in self.status_in.poll(self.now_ns):
            self.status = status
            if self.person_cranks and not status.missing_for_crank:
                self.ask(OperatorAction.CRANK)
        for state in self.states.poll(self.now_ns):
            if self.estimator_runs:
                self.bus.publish(topics.ESTIMATE, self.estimate(state.stamp_ns))
            if self.planner_runs and self.tick % 5 == 0:
                self.bus.publish(topics.COMMAND, self.command(state.stamp_ns))
                if self.publishes_plans:
                    self.bus.publish(topics.PLAN, self.plan(state.stamp_ns))
        for hook in self.hooks:
            hook(self)
        self.clock.advance(PERIOD_NS)
        self.tick += 1

    def run(self, seconds: float) -> None:
        """Run for a while."""
        for _ in range(round(seconds * 100)):
            self.step()

    def ask(self, action: OperatorAction) -> None:
        """A person's request, answered in the next period."""
        self.seq += 1
        self.bus.publish(
            topics.OPERATOR, OperatorCommand(stamp_ns=self.now_ns, seq=self.seq, source="test", action=action)
        )

    def drive_off(self, seconds: float = 2.0) -> None:
        """Climb the ladder, arm, drive."""
        self.run(1.0)
        self.ask(OperatorAction.ARM)
        self.run(seconds)
        assert self.action is FailsafeAction.DRIVE, self.status

    def command(self, state_stamp_ns: int, source: str = "planner") -> Command:
        """Next command of the planner stand-in."""
        self.seq += 1
        return Command(
            stamp_ns=self.now_ns, seq=self.seq, source=source, state_stamp_ns=state_stamp_ns,
            steer=self.steer, drive=self.drive, brake_balance=self.brake_balance,
        )  # fmt: skip

    def estimate(self, state_stamp_ns: int) -> Estimate:
        """Estimate of a car driving straight along x."""
        return Estimate(
            stamp_ns=self.now_ns, seq=self.tick, state_stamp_ns=state_stamp_ns,
            valid=self.estimate_valid and not self.lacks, lacks=self.lacks, x=self.car.x, y=self.aside, yaw=0.0,
            vx=self.car.speed, vy=0.0, yaw_rate=0.0, bias_ax=0.0, bias_ay=0.0, bias_yaw_rate=0.0,
            std=(0.0,) * 9, steer=0.0, drive=0.0, innovations_rejected=0,
        )  # fmt: skip

    def plan(self, state_stamp_ns: int, points: int = 41) -> Plan:
        """Straight ahead."""
        x = tuple(self.car.x + 2.0 * i for i in range(points))
        zero = (0.0,) * points
        plan = Plan(
            stamp_ns=self.now_ns, seq=self.tick, state_stamp_ns=state_stamp_ns, status=PlanStatus.SOLVED, dt=0.05,
            x=x, y=zero, yaw=zero, vx=(40.0,) * points, s=x, steer=zero, drive=zero, lap=0, revision="-", solve_ms=1.0,
        )  # fmt: skip
        return plan.model_copy(update=self.plan_changes)


def reported_state() -> VehicleState:
    """Of a car that has reported for 0.2 s and stands."""
    rig = Rig()
    rig.run(0.2)
    assert rig.gateway.seen is not None
    return rig.gateway.seen[0]
