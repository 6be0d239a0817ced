"""Frames to one vehicle state: decoding, counters, age and plausibility of every source.

Nothing that arrives can raise: a frame that cannot be decoded is counted, a value outside what the car can do
(`av24.toml`) makes its source invalid until a plausible one arrives, and the last plausible values stand meanwhile.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from can_dbc.codec import Codec, Fault, FaultKind
from can_dbc.database import Message as FrameLayout
from hil_gateway.bus.messages import SourceHealth, VehicleState
from hil_gateway.can_link import Frame
from hil_gateway.car.actuation import Actuation, Actuators
from hil_gateway.car.states import CtState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.fixes import MOVING, Fixes
from hil_gateway.gateway.perceive.frame_counts import FrameCounts, LeakyBucket, Senders
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.geodesy import LocalMap

SOURCES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "imu": ("imu_1", "imu_2", "imu_3"),
        "wheel_speeds": ("wheel_speed_report",),
        "steering": ("steering_report", "steering_report_extd"),
        "pedals": ("accelerator_report", "brake_pressure_report"),
        "powertrain": ("pt_report_1",),
        "vehicle": ("misc_report",),
        "position": ("novatel_report",),
        "race_control": ("base_to_car_summary",),
        "race_control_flags": ("marelli_report_1",),
        "diagnostics": ("diagnostic_report",),
    }
)
"""Name of a source -> the messages behind it; it is as old as the oldest of them."""

REQUIRED = ("imu", "wheel_speeds", "steering", "pedals", "powertrain", "vehicle")
"""Sources without which nothing is driven. Position has its own filter; race control its own heartbeat."""

ACTUATOR_COMMANDS = ("brake_pressure_cmd", "accelerator_cmd", "steering_cmd", "gear_shift_cmd")
FOREIGN_S = 1.0
"""How long a frame of another computer counts."""
STUCK_FRAMES = 20
"""So many IMU or wheel frames (0.2 s) with the very same bytes while moving: the sensor hangs (noise changes the last
bit of each; a sensor at 50 Hz repeats itself once)."""
SENSOR_DISAGREEMENT = 0.15
"""Primary against secondary steering angle, rad at the motor (about 9 deg)."""
MAP_RADIUS = 50e3
"""A position further from the origin is no position of this map, m (receivers report 0, 0 before their first fix)."""
COUNTER_LEAK_NS = NS_PER_S // 10
"""Time after which one wrong counter is forgotten."""
COUNTER_FAULT = 5
"""Level of the leaky bucket that is a fault."""


@dataclass(slots=True)
class _Received:
    """Newest frame of one message."""

    layout: FrameLayout
    limits: tuple[tuple[str, float, float], ...]
    deadline_ns: int
    repeatable: bool
    """the same bytes again say the same again: no counter, no new fix, no sensor that may hang"""
    watched: str
    """name of the message where more is watched than its limits, "imu" for every IMU, else empty"""
    stamp_ns: int | None = None
    data: bytes | None = None
    plausible: bool = False
    counter: int | None = None
    repeats: int = 0


class VehicleStateBuilder:
    """Keeps the newest plausible values of every message; one `build` a period."""

    def __init__(self, config: Config, codec: Codec, actuation: Actuation) -> None:
        self._codec = codec
        self._actuation = actuation
        self._map = LocalMap(config.origin)
        self._received = {
            layout.id: _Received(
                layout, _limits(layout), round(layout.deadline_s * NS_PER_S), _repeatable(layout), _watched(layout)
            )
            for layout in codec.messages.values()
            if layout.direction == "car"
        }
        self._by_name = {entry.layout.name: entry for entry in self._received.values()}
        self._sources = {name: tuple(self._by_name[m] for m in messages) for name, messages in SOURCES.items()}
        self._signals: defaultdict[str, float] = defaultdict(float)
        self.fixes = Fixes()
        self._seq = 0
        self._newest_ns: int | None = None
        self.counts = FrameCounts()
        self._foreign_emergency_ns: int | None = None
        self._foreign_command_ns: int | None = None
        self._foreign_report_ns: int | None = None
        self.senders = Senders({entry.layout.id: entry.layout.period_s for entry in self._received.values()})
        self.counter_faults = LeakyBucket(COUNTER_LEAK_NS, highest=2 * COUNTER_FAULT)

    def take(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Take in frames, oldest first."""
        for frame in frames:
            self._take_one(frame, now_ns)

    def age_s(self, message: str, now_ns: int) -> float:
        """Seconds since the last frame of `message`, plausible or not; infinite before the first."""
        return _age_s(self._by_name[message].stamp_ns, now_ns)

    @property
    def newest_ns(self) -> int:
        """When the newest frame of the car that could be decoded came; 0 before the first."""
        return self._newest_ns or 0

    def counter(self, message: str) -> int | None:
        """Newest rolling counter of a message that has one; None before the first."""
        return self._by_name[message].counter

    def layout(self, message: str) -> FrameLayout:
        """Of a message of the car."""
        return self._by_name[message].layout

    def heard(self, message: str) -> bool:
        """Whether a frame of `message` has ever come."""
        return self._by_name[message].stamp_ns is not None

    def silence_s(self, now_ns: int) -> float:
        """Seconds since the last frame of the car that could be decoded."""
        return _age_s(self._newest_ns, now_ns)

    def foreign_emergency(self, now_ns: int) -> bool:
        """Whether another computer on this bus has just reported ct_state 12."""
        return _age_s(self._foreign_emergency_ns, now_ns) <= FOREIGN_S

    def foreign_commands(self, now_ns: int) -> bool:
        """Whether another computer on this bus is commanding the actuators."""
        return _age_s(self._foreign_command_ns, now_ns) <= FOREIGN_S

    def foreign_reports(self, now_ns: int) -> bool:
        """Whether another computer on this bus says what state it is in."""
        return _age_s(self._foreign_report_ns, now_ns) <= FOREIGN_S

    def signal(self, name: str) -> float:
        """Newest plausible value of a signal, SI; 0 before the first."""
        return self._signals.get(name, 0.0)

    def build(self, now_ns: int, ct_state: int, track_flag: int, vehicle_flag: int) -> VehicleState:
        """State at `now_ns`; flags and ct_state come from race control."""
        sources = {name: self._health(entries, now_ns) for name, entries in self._sources.items()}
        signals = self._signals
        pedals = Actuators(
            steering_motor=signals["average_steering_ang_fdbk"],
            accelerator=min(max(signals["acc_pedal_fdbk"], 0.0), 1.0),
            brake_front=signals["brake_pressure_fdbk_front"],
            brake_rear=signals["brake_pressure_fdbk_rear"],
            gear=int(signals["current_gear"]),
        )
        engine_speed = signals["engine_speed"]
        self._seq += 1
        return VehicleState(
            stamp_ns=self._stamp(now_ns),
            seq=self._seq,
            valid=all(sources[name].valid for name in REQUIRED),
            sources=sources,
            ax=signals["imu_ax"],
            ay=signals["imu_ay"],
            az=signals["imu_az"],
            yaw_rate=signals["imu_yaw_rate"],
            roll_rate=signals["imu_roll_rate"],
            wheel_speed_fl=signals["wheel_speed_FL"],
            wheel_speed_fr=signals["wheel_speed_FR"],
            wheel_speed_rl=signals["wheel_speed_RL"],
            wheel_speed_rr=signals["wheel_speed_RR"],
            steer=self._actuation.to_steer(pedals.steering_motor),
            steer_rate=self._actuation.to_steer(signals["primary_steering_angular_rate"]),
            accelerator=pedals.accelerator,
            throttle=signals["throttle_position"],
            brake_front=pedals.brake_front,
            brake_rear=pedals.brake_rear,
            drive=self._actuation.to_drive(pedals, engine_speed, pedals.gear),
            gear=pedals.gear,
            engine_speed=engine_speed,
            position_x=self.fixes.x,
            position_y=self.fixes.y,
            position_seq=self.fixes.seq,
            sys_state=int(signals["sys_state"]),
            ct_state=ct_state,
            track_flag=track_flag,
            vehicle_flag=vehicle_flag,
        )

    def _stamp(self, now_ns: int) -> int:
        """When the newest frame arrived: an answer is as old as what it answers."""
        return now_ns if self._newest_ns is None else min(self._newest_ns, now_ns)

    def _take_one(self, frame: Frame, now_ns: int) -> None:
        self.counts.received += 1
        if frame.is_error:
            self.counts.errors += 1
            return
        entry = self._received.get(frame.id)
        self.senders.add(frame.id, now_ns)
        stamp_ns = frame.stamp_ns if frame.stamp_ns < now_ns else now_ns
        if entry is not None and entry.repeatable and frame.data == entry.data:
            entry.stamp_ns = self._newest_ns = stamp_ns
            self.counts.implausible += not entry.plausible
            return
        values = self._codec.decode(frame.id, frame.data)
        if isinstance(values, Fault):
            self._count_fault(values, now_ns)
            return
        if entry is None:
            self._note_foreign(self._codec.by_id[frame.id].name, values, now_ns)
            return
        self._check_counter(entry, values, now_ns)
        entry.repeats = entry.repeats + 1 if frame.data == entry.data else 0
        entry.stamp_ns = self._newest_ns = stamp_ns
        entry.data = frame.data
        entry.plausible = self._plausible(entry, values)
        if not entry.plausible:
            self.counts.implausible += 1
        elif entry.watched == "novatel_report":
            self._take_position(entry, values, stamp_ns)
        else:
            self._signals.update(values)

    def _take_position(self, entry: _Received, values: Mapping[str, float], stamp_ns: int) -> None:
        x, y = self._map.to_map_radians(values["novatel_lat"], values["novatel_long"])
        entry.plausible = max(abs(x), abs(y)) < MAP_RADIUS
        if entry.plausible:
            self.fixes.take(x, y, stamp_ns)
        else:
            self.counts.implausible += 1

    def _note_foreign(self, name: str, values: Mapping[str, float], now_ns: int) -> None:
        """A message only the computer sends, from somebody else: own frames are not received back."""
        if name == "ct_report":
            self._foreign_report_ns = now_ns
            if int(values["ct_state"]) == CtState.EMERGENCY:
                self._foreign_emergency_ns = now_ns
        elif name in ACTUATOR_COMMANDS:
            self._foreign_command_ns = now_ns

    def _count_fault(self, fault: Fault, now_ns: int) -> None:
        if fault.kind is FaultKind.UNKNOWN_ID:
            self.counts.unknown += 1
            return
        self.counts.malformed += 1
        if self._codec.by_id[fault.frame_id].name in ACTUATOR_COMMANDS:  # the car may read it all the same
            self._foreign_command_ns = now_ns

    def _check_counter(self, entry: _Received, values: Mapping[str, float], now_ns: int) -> None:
        counter = entry.layout.counter
        if counter is None:
            return
        value = int(values[counter.signal])
        if entry.counter is not None:
            gap = (value - entry.counter - 1) % counter.modulus
            if gap:
                self.counts.counter_errors += 1
                self.counter_faults.add(now_ns)
                self.counts.lost += gap if gap < counter.modulus // 2 else 0  # more: repeated or late, not lost
        entry.counter = value

    def _plausible(self, entry: _Received, values: Mapping[str, float]) -> bool:
        for name, low, high in entry.limits:
            if not low <= values[name] <= high:
                return False
        watched = entry.watched
        if not watched:
            return True
        if watched == "steering_report_extd":
            apart = values["primary_steering_angle_fbk"] - values["secondary_steering_ang_fdbk"]
            return abs(apart) <= SENSOR_DISAGREEMENT
        if watched == "imu":
            return entry.repeats < STUCK_FRAMES or self._signals["wheel_speed_RL"] < MOVING
        if watched == "wheel_speed_report":
            fastest = max(values.values())
            locked_or_dead = fastest < STANDSTILL and self.fixes.moving
            return not locked_or_dead and (entry.repeats < STUCK_FRAMES or fastest < MOVING)
        return True

    def _health(self, entries: tuple[_Received, ...], now_ns: int) -> SourceHealth:
        """As old as its oldest message; valid when every message is in time, plausible and from one sender."""
        valid, oldest_ns, doubled = True, now_ns, self.senders.doubled
        for entry in entries:
            stamp_ns = entry.stamp_ns
            if stamp_ns is None:
                return _NEVER_HEARD
            in_time = now_ns - stamp_ns <= entry.deadline_ns
            valid = valid and entry.plausible and in_time and not (doubled and entry.layout.id in doubled)
            oldest_ns = min(oldest_ns, stamp_ns)
        return SourceHealth(age_s=(now_ns - oldest_ns) / NS_PER_S, valid=valid)


_NEVER_HEARD = SourceHealth(age_s=None, valid=False)


def _limits(layout: FrameLayout) -> tuple[tuple[str, float, float], ...]:
    """What the car can do (`av24.toml`), SI."""
    return tuple((signal.si_name, *signal.si_limits) for signal in layout.signals if signal.si_limits is not None)


def _watched(layout: FrameLayout) -> str:
    name = "imu" if layout.name.startswith("imu_") else layout.name
    return name if name in ("imu", "wheel_speed_report", "novatel_report", "steering_report_extd") else ""


def _repeatable(layout: FrameLayout) -> bool:
    return layout.counter is None and _watched(layout) in ("", "steering_report_extd")


def _age_s(stamp_ns: int | None, now_ns: int) -> float:
    return float("inf") if stamp_ns is None else (now_ns - stamp_ns) / NS_PER_S
