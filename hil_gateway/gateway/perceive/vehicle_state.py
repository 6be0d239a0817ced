"""Frames to one vehicle state: decoding, counters, age and plausibility of every source.

Nothing that arrives can raise: a frame that cannot be decoded is counted, a value outside what the car can do
(`bus.toml`) makes its source invalid until a plausible one arrives, and the last plausible values stand meanwhile.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, Literal

from can_dbc.codec import COUNTER, Codec, Fault, FaultKind
from can_dbc.quantities import WHEELS
from hil_gateway.bus.messages import SourceHealth, VehicleState
from hil_gateway.bus.outside import Navigation
from hil_gateway.can_link import Frame
from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.car.states import SysState, TrackFlag, VehicleFlag, meanings
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, NAMED_S
from hil_gateway.gateway.perceive.frame_counts import FrameCounts, LeakyBucket
from hil_gateway.gateway.perceive.imu_place import ImuPlace
from hil_gateway.gateway.perceive.positions.fixes import Fixes, latest_s
from hil_gateway.gateway.perceive.positions.network import NetworkReceivers
from hil_gateway.gateway.perceive.received import Received, received_messages
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.geodesy import LocalMap

REQUIRED = ("imu", "wheel_speeds", "steering", "pedals", "powertrain", "vehicle")
"""Sources without which nothing is driven. Position has its own filter; race control its own heartbeat."""
CLOCKS = ("pedals", "steering", "vehicle", "powertrain")
"""Sources whose rolling counter tells the time of the drive-by-wire node."""
AS_REPORTED = (*(f"wheel_speed_{wheel}" for wheel in WHEELS), "brake_front", "brake_rear", "engine_speed")
"""quantities that the state has as the car reports them"""
COUNTER_LEAK_NS = round(CONTRADICTED_S * NS_PER_S)
"""after which one wrong counter is forgotten"""
COUNTER_FAULT = 5
"""Level of the leaky bucket that is a fault."""

Foreign = Literal["commands", "reports", "reports an emergency"]
"""what another computer does on this bus: commands the actuators, or says its state, or that this is an emergency"""


class VehicleStateBuilder:
    """Keeps the newest plausible value of every quantity; one `build` a period."""

    def __init__(self, config: Config, actuation: Actuation) -> None:
        car, codec = config.car, config.car.codec
        self._codec = codec
        self._actuation = actuation
        self._map = LocalMap(config.origin)
        self._newest: defaultdict[str, float] = defaultdict(float)
        self.fixes = Fixes(config.placing.noise, max(latest_s(car, name) for name in car.receivers))
        self.network = NetworkReceivers(config)
        """receivers that place the car in the stead of the one on its bus, where there are any"""
        self._received = received_messages(car, self._newest, self.fixes)
        by_name = {entry.layout.name: entry for entry in self._received.values()}
        self._groups = {
            source: tuple(by_name[message] for message in messages)
            for source, messages in codec.signals.sources.items()
        }
        self._imus = [_ImuReadings(name, ImuPlace(imu)) for name, imu in car.imus.items()]
        self._imu = self._imus[0]
        self._receiver = next(iter(car.receivers))
        listed = {name: entries for name, entries in self._groups.items() if "." not in name}
        on_bus = {} if self.network else {"position": self._groups[f"receiver.{self._receiver}"]}
        self._listed = listed | on_bus
        self._latitude, self._longitude = (f"receiver.{self._receiver}.{name}" for name in ("latitude", "longitude"))
        self._no_mode_switch = float("mode_switch" not in codec.signals.reports)
        self._track_flags = meanings(codec.signals.codes["track_flag"], TrackFlag)
        self._vehicle_flags = meanings(codec.signals.codes["vehicle_flag"], VehicleFlag)
        self._sys_states = meanings(codec.signals.codes["sys_state"], SysState)
        self.rungs = frozenset[int](self._sys_states.values())
        """states of the car that its ladder has"""
        self._emergency = codec.signals.codes["ct_state"]["emergency"]
        self._commands = frozenset(codec.signals.actuator_messages)
        self._steering_rate = _SteeringRate(codec)
        clocks = (entry for source in CLOCKS for entry in self._groups[source] if entry.layout.counter is not None)
        self.clock = next(clocks, None)
        """newest frame of a message of the drive-by-wire node that counts; None where none does"""
        self._seq = 0
        self._newest_ns: int | None = None
        self.counts = FrameCounts()
        self._foreign_ns: dict[Foreign, int] = {}
        """when another computer on this bus last did so"""
        self.counter_faults = LeakyBucket(COUNTER_LEAK_NS, highest=2 * COUNTER_FAULT)

    def take(self, frames: Sequence[Frame], now_ns: int) -> None:
        """Take in frames, oldest first."""
        self.counts.received += len(frames)
        for frame in frames:
            self._take_one(frame, now_ns)

    def hear(self, messages: Iterable[Navigation], now_ns: int) -> None:
        """Take in what receivers on the network say, oldest first."""
        self.network.take(messages, now_ns)

    def age_s(self, source: str, now_ns: int) -> float:
        """Seconds since the oldest of the newest frames of a source, plausible or not; infinite before the first, or
        where the car has no such source."""
        ages = [_age_s(entry.stamp_ns, now_ns) for entry in self._groups.get(source, ())]
        return max(ages, default=float("inf"))

    @property
    def newest_ns(self) -> int:
        """When the newest frame of the car that could be decoded came; 0 before the first."""
        return self._newest_ns or 0

    def silence_s(self, now_ns: int) -> float:
        """Seconds since the last frame of the car that could be decoded."""
        return _age_s(self._newest_ns, now_ns)

    def another(self, does: Foreign, now_ns: int) -> bool:
        """Whether another computer on this bus has just done so."""
        return _age_s(self._foreign_ns.get(does), now_ns) <= NAMED_S

    def value(self, quantity: str, before: float = 0.0) -> float:
        """Newest plausible value of a quantity, SI; `before` the first, and where the car does not report it."""
        return self._newest.get(quantity, before)

    def track_flag(self, quantity: str) -> TrackFlag:
        """Meaning of a track flag."""
        return self._track_flags.get(int(self.value(quantity)), TrackFlag.UNKNOWN)

    def vehicle_flag(self, quantity: str) -> VehicleFlag:
        """Meaning of a vehicle flag."""
        return self._vehicle_flags.get(int(self.value(quantity)), VehicleFlag.UNKNOWN)

    @property
    def doubled(self) -> bool:
        """Whether any message comes from more than one sender."""
        return any(map(attrgetter("doubled"), self._received.values()))

    @property
    def mode_switch(self) -> bool:
        """Whether the car may be driven by a computer; it may where it has no such switch."""
        return self.value("mode_switch", self._no_mode_switch) > 0

    @property
    def failing(self) -> bool:
        """Whether the car reports a failure of its own."""
        return any(map(self._newest.get, self._codec.signals.failures))

    def known(self, quantity: str) -> bool:
        """Whether a plausible value of it has ever come."""
        return quantity in self._newest

    def reported(self, prefix: str) -> tuple[str, ...]:
        """Names of the quantities of the car that begin so."""
        return tuple(name for name in self._codec.signals.reports if name.startswith(prefix))

    def build(
        self, now_ns: int, ct_state: int, track_flag: int, vehicle_flag: int, steer_late: float = 0.0
    ) -> VehicleState:
        """State at `now_ns`; flags and ct_state come from race control, what is learnt of the steering from driving."""
        sources = self._healths(now_ns)
        newest, imu = self._newest, self._imu
        yaw_rate = newest[imu.yaw_rate]
        ax, ay = imu.place.to_centre(now_ns / NS_PER_S, newest[imu.ax], newest[imu.ay], yaw_rate)
        accelerator, gear = min(max(newest["accelerator"], 0.0), 1.0), int(newest["gear"])
        as_reported: dict[str, Any] = {name: newest[name] for name in AS_REPORTED}
        brakes = newest["brake_front"], newest["brake_rear"]
        pedals, stamp_ns = ActuatorPositions(newest["steering_motor"], accelerator, *brakes, gear), self._stamp(now_ns)
        self._take_from_network(stamp_ns, ax, yaw_rate)
        self._seq += 1
        return VehicleState(
            stamp_ns=stamp_ns,
            seq=self._seq,
            valid=all(sources[name].valid for name in REQUIRED),
            sources=sources,
            imu=imu.name,
            receiver=self.network.name or self._receiver,
            ax=ax,
            ay=ay,
            az=newest[imu.az],
            yaw_rate=yaw_rate,
            roll_rate=newest[imu.roll_rate],
            steer=self._actuation.to_steer(pedals.steering_motor),
            steer_late=steer_late,
            steer_rate=self._actuation.to_steer(self._steering_rate.of(newest, now_ns)),
            accelerator=accelerator,
            throttle=newest.get("throttle", accelerator),
            drive=self._actuation.to_drive(pedals, newest["engine_speed"], gear),
            gear=gear,
            position_x=self.fixes.x,
            position_y=self.fixes.y,
            position_seq=self.fixes.seq,
            position_stamp_ns=self.fixes.stamp_ns,
            heading=self.network.heading(stamp_ns) if self.network else None,
            sys_state=self._sys_states.get(int(newest["sys_state"]), SysState.UNKNOWN),
            ct_state=ct_state,
            track_flag=track_flag,
            vehicle_flag=vehicle_flag,
            **as_reported,
        )

    def _healths(self, now_ns: int) -> dict[str, SourceHealth]:
        """Of every source. `imu` is that of the sensor in use, which stays so while it is valid, then the first that
        is; where there are several, each is listed beside it."""
        imus = {imu.source: self._health(self._groups[imu.source], now_ns) for imu in self._imus}
        if not imus[self._imu.source].valid:
            self._imu = next((imu for imu in self._imus if imus[imu.source].valid), self._imu)
        found = {name: self._health(entries, now_ns) for name, entries in self._listed.items()}
        found["imu"] = imus[self._imu.source]
        if self.network:
            found |= self.network.healths(now_ns)
        return found | imus if len(imus) > 1 else found

    def _stamp(self, now_ns: int) -> int:
        """When the newest frame arrived: an answer is as old as what it answers."""
        return now_ns if self._newest_ns is None else min(self._newest_ns, now_ns)

    def _take_one(self, frame: Frame, now_ns: int) -> None:
        if frame.is_error:
            self.counts.errors += 1
            return
        entry, data = self._received.get(frame.id), frame.data
        if entry is None:
            self._take_foreign(frame, now_ns)
            return
        entry.count(now_ns)
        stamp_ns = frame.stamp_ns if frame.stamp_ns < now_ns else now_ns
        if entry.repeatable and data == entry.data:
            entry.stamp_ns = self._newest_ns = stamp_ns
            self.counts.implausible += not entry.plausible
            return
        values = entry.decode(data)
        if isinstance(values, Fault):
            self.counts.malformed += 1
            return
        if entry.modulus:
            self._check_counter(entry, int(values[COUNTER]), now_ns)
        entry.repeats = entry.repeats + 1 if data == entry.data else 0
        entry.stamp_ns = self._newest_ns = stamp_ns
        entry.data = data
        entry.plausible = _plausible(entry, values)
        if entry.places and entry.plausible:
            self._take_position(entry, values, stamp_ns)
        if entry.plausible:
            self._newest.update(values)
        else:
            self.counts.implausible += 1

    def _take_position(self, entry: Received, values: Mapping[str, float], stamp_ns: int) -> None:
        x, y = self._map.to_map_radians(values[self._latitude], values[self._longitude])
        entry.plausible = self._map.holds(x, y)
        if entry.plausible and not self.network:
            self.fixes.take(x, y, stamp_ns)

    def _take_from_network(self, stamp_ns: int, ax: float, yaw_rate: float) -> None:
        fix = self.network.step(stamp_ns, ax, yaw_rate) if self.network else None
        if fix is None:
            return
        x, y = self._map.to_map(*fix[:2])
        if self._map.holds(x, y):
            self.fixes.take(x + fix[2], y + fix[3], stamp_ns)

    def _take_foreign(self, frame: Frame, now_ns: int) -> None:
        """What only a computer sends, from somebody else (own frames are not received back), or nobody."""
        values = self._codec.decode_quantities(frame.id, frame.data)
        if isinstance(values, Fault) and values.kind is FaultKind.UNKNOWN_ID:
            self.counts.unknown += 1
            return
        if self._codec.by_id[frame.id].name in self._commands:  # the car may read it, whatever its length
            self._foreign_ns["commands"] = now_ns
        if isinstance(values, Fault):
            self.counts.malformed += 1
        elif "ct_state" in values:
            self._foreign_ns["reports"] = now_ns
            if int(values["ct_state"]) == self._emergency:
                self._foreign_ns["reports an emergency"] = now_ns

    def _check_counter(self, entry: Received, value: int, now_ns: int) -> None:
        if entry.counter is not None:
            gap = (value - entry.counter - 1) % entry.modulus
            if gap:
                self.counts.counter_errors += 1
                self.counter_faults.add(now_ns)
                self.counts.lost += gap if gap < entry.modulus // 2 else 0  # more: repeated or late, not lost
        entry.counter = value

    def _health(self, entries: tuple[Received, ...], now_ns: int) -> SourceHealth:
        """As old as its oldest message; valid when every message is in time, plausible and from one sender."""
        valid, oldest_ns = True, now_ns
        for entry in entries:
            stamp_ns = entry.stamp_ns
            if stamp_ns is None:
                return _NEVER_HEARD
            in_time = now_ns - stamp_ns <= entry.deadline_ns
            valid = valid and entry.plausible and in_time and not entry.doubled
            oldest_ns = min(oldest_ns, stamp_ns)
        return SourceHealth(age_s=(now_ns - oldest_ns) / NS_PER_S, valid=valid)


def _plausible(entry: Received, values: Mapping[str, float]) -> bool:
    for name, low, high in entry.limits:
        if not low <= values[name] <= high:
            return False
    return not entry.checks or all(check(entry, values) for check in entry.checks)


_NEVER_HEARD = SourceHealth(age_s=None, valid=False)


class _ImuReadings:
    """Names of the quantities of one inertial sensor."""

    def __init__(self, name: str, place: ImuPlace) -> None:
        self.name, self.source, self.place = name, f"imu.{name}", place
        self.ax, self.ay, self.az = (f"imu.{name}.{axis}" for axis in ("ax", "ay", "az"))
        self.yaw_rate, self.roll_rate = f"imu.{name}.yaw_rate", f"imu.{name}.roll_rate"


class _SteeringRate:
    """Rate of the steering motor, rad/s: as the car reports it, else by the difference of its angles."""

    def __init__(self, codec: Codec) -> None:
        self._reported = "steering_motor_rate" in codec.signals.reports
        self._last: tuple[int, float] | None = None

    def of(self, newest: Mapping[str, float], now_ns: int) -> float:
        """Once a period."""
        if self._reported:
            return newest["steering_motor_rate"]
        last, self._last = self._last, (now_ns, newest["steering_motor"])
        return 0.0 if last is None or now_ns <= last[0] else (self._last[1] - last[1]) * NS_PER_S / (now_ns - last[0])


def _age_s(stamp_ns: int | None, now_ns: int) -> float:
    return float("inf") if stamp_ns is None else (now_ns - stamp_ns) / NS_PER_S
