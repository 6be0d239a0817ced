"""All messages the car sends, at the periods of its bus, from the state of the simulated car."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

from can_dbc.codec import COUNTER, Encoder
from can_dbc.database import BusMessage
from can_dbc.quantities import WHEELS
from hil_gateway.can_link import CanLink
from hil_gateway.car.car import Car as Platform
from hil_gateway.car.states import TrackFlag, VehicleFlag
from hil_gateway.plant.car import Car
from hil_gateway.plant.controller.base_station import SimulatedRaceControl
from hil_gateway.plant.controller.ladder import CarState, ReceivedCommand, VehicleController
from hil_gateway.plant.controller.sensors import SimulatedSensors, Values
from hil_gateway.plant.referee.referee import Referee
from hil_gateway.process.clock import NS_PER_S

AMBIENT_C, WARM_TYRE_C = 25.0, 80.0
TYRE_PA, AIR_PA = 1.6e5, 1.013e5
"""over the air outside, and that air"""
BRAKE_TRAVEL = 7500.0
"""counts of the brake actuators at full pressure"""
CLOCK = 2e-4
"""by which the clock of a node may be off: a period in 50 s"""
Source = Callable[[], Values]
"""readings of one instant"""


@dataclass(slots=True)
class _Report:
    """A message: what is read for it alone, its encoder, and its counter; modulus 0 where it has none."""

    sources: tuple[Source, ...]
    encode: Encoder
    modulus: int
    count: int = -1


@dataclass(slots=True)
class _Group:
    """Messages that are sent together."""

    period_ns: int
    reports: list[_Report]
    due_ns: int = 0


class ReportTransmitter:
    """Sends what is due."""

    def __init__(
        self,
        *,
        platform: Platform,
        link: CanLink,
        car: Car,
        sensors: SimulatedSensors,
        controller: VehicleController,
        referee: Referee,
        race_control: SimulatedRaceControl,
        positions: bool = True,
    ) -> None:
        """`platform`: whose bus it speaks on; the receiver that places the car is on it where `positions` are."""
        self._platform, self._codec, self._link = platform, platform.codec, link
        self._car, self._sensors, self._controller, self._referee = car, sensors, controller, referee
        self._race_control = race_control
        self._received = ReceivedCommand()
        self._states = self._codes_of_states()
        reports = self._codec.signals.reports
        self._warm = {
            wheel: dict.fromkeys((name for name in reports if name.startswith(f"tyre.{wheel}.")), WARM_TYRE_C)
            for wheel in WHEELS
        }
        """temperatures of a tyre"""
        self._sources = self._sources_of_quantities()
        placing = f"receiver.{next(iter(platform.receivers))}.latitude"
        own = ((m, self._codec.quantities(m.name)) for m in self._codec.messages.values() if m.direction == "car")
        self._messages = [(m, quantities) for m, quantities in own if positions or placing not in quantities]
        self._groups = self._grouped(lambda quantities: None)
        self.next_ns = 0
        """when the next message is due; nothing needs to be called before"""

    def step(self, now_ns: int, received: ReceivedCommand) -> None:
        """Send every message whose period has passed."""
        self._received = received
        for group in self._groups:
            due_ns, period_ns = group.due_ns or now_ns, group.period_ns
            group.due_ns = due_ns
            if now_ns < due_ns:
                continue
            group.due_ns = due_ns + period_ns if now_ns - due_ns < period_ns else now_ns + period_ns
            send, readings = self._link.send, Values()
            for report in group.reports:
                for source in report.sources:
                    readings |= source()
                if report.modulus:
                    readings[COUNTER] = report.count = (report.count + 1) % report.modulus
                send(*report.encode(readings))
        self.next_ns = min([group.due_ns for group in self._groups])

    def run_free(self, now_ns: int, rng: random.Random) -> None:
        """Before the first frame: every sensor is to send at a time of its own, by a clock of its own."""
        self._groups = self._grouped(lambda quantities: self._sources[quantities[0]] if quantities else None)
        for group in self._groups:
            group.due_ns = now_ns + rng.randrange(group.period_ns)
            group.period_ns = round(group.period_ns * (1.0 + rng.uniform(-CLOCK, CLOCK)))

    def _grouped(self, reader: Callable[[tuple[str, ...]], Source | None]) -> list[_Group]:
        """Messages of the same period and the same `reader` of their quantities."""
        groups: dict[tuple[int, Source | None], _Group] = {}
        for message, quantities in self._messages:
            period_ns = round(message.period_s * NS_PER_S)
            group = groups.setdefault((period_ns, reader(quantities)), _Group(period_ns, []))
            group.reports.append(self._report(message, quantities, group.reports))
        return list(groups.values())

    def _report(self, message: BusMessage, quantities: tuple[str, ...], before: list[_Report]) -> _Report:
        """A message of those that are sent together: several share what one sensor reads."""
        read = [source for report in before for source in report.sources]
        sources = dict.fromkeys(self._sources[name] for name in quantities)
        modulus = 0 if message.counter is None else message.counter.modulus
        encode = self._codec.quantity_encoders[message.name]
        return _Report(tuple(source for source in sources if source not in read), encode, modulus)

    def _sources_of_quantities(self) -> Mapping[str, Source]:
        """Quantity that the car's bus carries -> what reads it."""
        signals, sensors = self._codec.signals, self._sensors
        found: dict[str, Source] = {}
        for silent in (self._actuators, self._powertrain, self._state, self._fluids, self._timing, self._sound):
            found |= dict.fromkeys(silent(), silent)
        for group, source in self._drawn().items():
            found |= dict.fromkeys(group, source)
        readers = {"imu": sensors.imu, "receiver": sensors.position, "tyre": self._tyre}
        of_one: dict[tuple[str, str], Source] = {}
        for name in signals.reports:
            kind, _, rest = name.partition(".")
            if kind in readers:
                which = rest.partition(".")[0]
                found[name] = of_one.setdefault((kind, which), partial(readers[kind], which))
        return found

    def _drawn(self) -> Mapping[tuple[str, ...], Source]:
        """Quantities that are read together and change by being read: noise is drawn, a heart beats."""
        return {
            tuple(f"wheel_speed_{wheel}" for wheel in WHEELS): self._sensors.wheel_speeds,
            ("steering_motor", "steering_motor_primary", "steering_motor_secondary"): self._steering,
            ("heartbeat", "track_flag", "vehicle_flag"): self._base,
            ("second_track_flag", "second_vehicle_flag", "second_sector_flag"): self._second,
        }

    def _sound(self) -> Values:
        return dict.fromkeys(self._codec.signals.failures, 0.0)

    def _steering(self) -> Values:
        ratio = self._platform.vehicle.steering_ratio
        primary, secondary = (self._sensors.steering() * ratio for _ in range(2))
        return {
            "steering_motor": 0.5 * (primary + secondary),
            "steering_motor_primary": primary,
            "steering_motor_secondary": secondary,
        }

    def _actuators(self) -> Values:
        """Pedals, brakes and the steering motor."""
        car, asked = self._car, self._received.commands
        most, rate = (
            self._platform.powertrain.brake_pressure_max,
            car.steer_rate * self._platform.vehicle.steering_ratio,
        )
        duty, front, rear = car.steer_rate / car.parameters.car.steer_rate, car["brake_front"], car["brake_rear"]
        return {
            "accelerator": car["throttle"],
            "brake_front": front,
            "brake_rear": rear,
            "brake_position_front_asked": BRAKE_TRAVEL * min(asked.brake_front / most, 1.0),
            "brake_position_front": BRAKE_TRAVEL * front / most,
            "brake_position_rear_asked": BRAKE_TRAVEL * min(asked.brake_rear / most, 1.0),
            "brake_position_rear": BRAKE_TRAVEL * rear / most,
            "brake_force_front": 4.0e-4 * front,
            "brake_force_rear": 4.0e-4 * rear,
            "steering_motor_rate": rate,
            "steering_motor_rate_asked": rate,
            "steering_duty_asked": duty,
            "steering_duty": duty,
            "steering_current": 20.0 * abs(duty),
            "steering_voltage": self._at_rest("steering_voltage", 12.6),
            "steering_temperature": AMBIENT_C + 15.0,
            "steering_torque": 5.0 * abs(duty),
            **{f"load_{wheel}": car.output(f"load_{wheel}") for wheel in WHEELS},
        }

    def _powertrain(self) -> Values:
        car, running = self._car, self._controller.engine_running
        return {
            "engine_run_switch": 1.0,
            "engine_on": float(running),
            "throttle": car["throttle"],
            "gear": float(car.gear),
            "engine_speed": car.output("engine_speed") if running else 0.0,
            "speed": abs(car["vx"]),
            "shifting": float(car.shifting > 0),
            "axle_torque": car.output("axle_torque"),
        }

    def _state(self) -> Values:
        """What the vehicle controller says of itself."""
        control = self._controller
        silent = float(control.state is CarState.EMERGENCY and control.cause == "commands silent")
        return {
            "sys_state": float(self._states[control.state]),
            "mode_switch": 1.0,
            "safety_switch": 0.0,
            "battery_voltage": self._at_rest("battery_voltage", 12.8),
            "target_speed": self._race_control.target_speed,
            "commands_lost": silent,
            "computer_lost": silent,
            "race_control_lost": float(not self._race_control.beating),
            "race_control_heard": float(self._race_control.beating),
            "signal_strength": -60.0,
        }

    def _fluids(self) -> Values:
        running = self._controller.engine_running
        return {
            "fuel_pressure": 350e3 * running,
            "oil_pressure": 420e3 * running,
            "transmission_pressure": 300e3 * running,
            "coolant_temperature": 85.0 if running else AMBIENT_C,
            "oil_temperature": 95.0 if running else AMBIENT_C,
            "transmission_temperature": 70.0 if running else AMBIENT_C,
        }

    def _timing(self) -> Values:
        times = self._referee.lap_times_s
        return {
            "rank": 1.0,
            "lap": float(self._referee.laps),
            "laps": float(self._referee.laps),
            "lap_distance": self._car.road.s,
            "lap_time": times[-1] if times else 0.0,
            "time": self._car.time_s,
            "timing_speed": abs(self._car["vx"]),
            "timing_heading": self._car["yaw"],
        }

    def _tyre(self, wheel: str) -> Values:
        over = TYRE_PA * (1.0 - self._car.flats[WHEELS.index(wheel)])
        return self._warm[wheel] | {f"tyre.{wheel}.pressure": AIR_PA + over, f"tyre.{wheel}.gauge": over}

    def _base(self) -> Values:
        control = self._race_control
        control.heartbeat = (control.heartbeat + control.beating) % 16
        return {
            "heartbeat": float(control.heartbeat),
            "track_flag": self._flag("track_flag", TrackFlag(control.track_flag)),
            "vehicle_flag": self._flag("vehicle_flag", VehicleFlag(control.vehicle_flag)),
        }

    def _second(self) -> Values:
        control = self._race_control
        return {
            "second_track_flag": self._flag("second_track_flag", TrackFlag(control.track_flag)),
            "second_vehicle_flag": self._flag("second_vehicle_flag", VehicleFlag(control.vehicle_flag)),
            "second_sector_flag": 0.0,
        }

    def _flag(self, quantity: str, flag: IntEnum) -> float:
        """Code of a flag; that of none where the car has no such flag, or the signal cannot carry it."""
        place, codes = (
            self._codec.signals.reports.get(quantity),
            self._codec.signals.codes[quantity.removeprefix("second_")],
        )
        code, none = codes.get(flag.name.lower(), codes.get("none", 0)), float(codes.get("none", 0))
        return float(code) if place is None or place.scale * place.raw(code) + place.zero == code else none

    def _codes_of_states(self) -> Mapping[CarState, int]:
        """Code of each state; of the one before where the car's ladder does not have it."""
        codes, found, last = self._codec.signals.codes["sys_state"], {}, 0
        for state in CarState:
            last = codes.get(state.name.lower(), last)
            found[state] = last
        return found

    def _at_rest(self, quantity: str, usual: float) -> float:
        """What `signals.toml` lets a signal rest at."""
        signals = self._codec.signals
        place = signals.reports.get(quantity)
        if place is None or place.signal.name not in signals.resting:
            return usual
        return place.factor * signals.resting[place.signal.name] + place.offset
