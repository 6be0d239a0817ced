"""All messages the car sends, at the periods of the DBC, from the state of the simulated car."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from can_dbc.codec import Codec
from can_dbc.database import Message
from hil_gateway.can_link import CanLink
from hil_gateway.plant.car import Car
from hil_gateway.plant.controller.ladder import Received, SysState, VehicleController
from hil_gateway.plant.controller.sensors import Sensors, StandaloneReceiver
from hil_gateway.plant.referee.referee import Referee
from hil_gateway.process.clock import NS_PER_S

Values = dict[str, float]
AMBIENT_C = 25.0
TYRE_PA, AIR_PA = 1.6e5, 1.013e5
"""over the air outside, and that air"""
WHEELS = ("FL", "FR", "RL", "RR")
LOADS = tuple((f"wheel_strain_gauge_{wheel.upper()}", f"load_{wheel}") for wheel in ("fl", "fr", "rl", "rr"))


@dataclass
class RaceControl:
    """What the base station says; tests and people change it."""

    track_flag: int = 1
    vehicle_flag: int = 0
    beating: bool = True
    heartbeat: int = 0


class Transmitter:
    """Sends what is due."""

    def __init__(
        self,
        *,
        codec: Codec,
        link: CanLink,
        car: Car,
        sensors: Sensors,
        controller: VehicleController,
        referee: Referee,
        race_control: RaceControl,
        steering_ratio: float,
    ) -> None:
        self._codec, self._link = codec, link
        self._car, self._sensors, self._controller, self._referee = car, sensors, controller, referee
        self._race_control = race_control
        self._received = Received()
        self._counters: dict[str, int] = {}
        self._imu: Values = {}
        self._ratio = steering_ratio
        self._by_period: dict[int, list[tuple[Message, Callable[[], Values] | None]]] = {}
        sources = self._sources()
        for message in codec.messages.values():
            if message.direction == "car":
                period_ns = round(message.period_s * NS_PER_S)
                self._by_period.setdefault(period_ns, []).append((message, sources.get(message.name)))
        self._resting = {
            name: codec.encode(name, {s.si_name: _resting(s.name, s.unit) for s in message.signals})
            for name, message in codec.messages.items()
            if name not in sources
        }
        self._due_ns: dict[int, int] = {}
        self.next_ns = 0
        """when the next message is due; nothing needs to be called before"""
        self._healthy: Values = dict.fromkeys((s.name for s in codec.messages["diagnostic_report"].signals), 0.0)

    def step(self, now_ns: int, received: Received) -> None:
        """Send every message whose period has passed."""
        self._received = received
        for period_ns, messages in self._by_period.items():
            due = self._due_ns.setdefault(period_ns, now_ns)
            if now_ns < due:
                continue
            self._due_ns[period_ns] = due + period_ns if now_ns - due < period_ns else now_ns + period_ns
            self._imu.clear()
            for message, source in messages:
                if source is None:
                    self._link.send(*self._resting[message.name])
                else:
                    self._send(message, source())
        self.next_ns = min(self._due_ns.values())

    def _send(self, message: Message, values: Values) -> None:
        if message.counter is not None:
            count = (self._counters.get(message.name, -1) + 1) % message.counter.modulus
            self._counters[message.name] = count
            values[message.counter.signal] = count
        self._link.send(*self._codec.encode(message.name, values))

    def _sources(self) -> Mapping[str, Callable[[], Values]]:
        return {
            "imu_1": lambda: self._imu_values("imu_yaw_rate", "imu_ay"),
            "imu_2": lambda: self._imu_values("imu_roll_rate", "imu_ax"),
            "imu_3": lambda: self._imu_values("imu_az"),
            "wheel_speed_report": self._sensors.wheel_speeds,
            "brake_pressure_report": self._brakes,
            "accelerator_report": lambda: {"acc_pedal_fdbk": self._car["throttle"]},
            "steering_report": self._steering,
            "steering_report_extd": self._steering_angles,
            "steering_report_extd_2": self._steering_motor,
            "misc_report": self._misc,
            "wheel_strain_gauge": self._loads,
            "brake_report_extd": self._brake_positions,
            "brake_report_extd_2": self._brake_forces,
            "pt_report_1": self._powertrain,
            "pt_report_2": self._fluids,
            "pt_report_3": self._torque,
            "diagnostic_report": self._diagnostics,
            "novatel_report": partial(_position, self._sensors, "novatel_lat", "novatel_long"),
            "mylaps_report_1": self._mylaps,
            "mylaps_report_2": partial(_position, self._sensors.mylaps, "Latitude", "Longitude"),
            "marelli_report_1": self._marelli,
            "marelli_report_2": partial(_position, self._sensors.marelli, "marelli_gps_lat", "marelli_gps_long"),
            "base_to_car_summary": self._base,
            **{f"Tire_Pressure_{wheel}": partial(self._tyre_pressure, wheel, i) for i, wheel in enumerate(WHEELS)},
            "base_to_car_timing": self._timing,
        }

    def _tyre_pressure(self, wheel: str, index: int) -> Values:
        over = TYRE_PA * (1.0 - self._car.flats[index])
        return {f"{wheel}_Tire_Pressure": AIR_PA + over, f"{wheel}_Tire_Pressure_Gauge": over}

    def _imu_values(self, *names: str) -> Values:
        """One sample of the IMU fills its three frames."""
        if not self._imu:
            self._imu.update(self._sensors.imu())
        return {name: self._imu[name] for name in names}

    def _brakes(self) -> Values:
        return {
            "brake_pressure_fdbk_front": self._car["brake_front"],
            "brake_pressure_fdbk_rear": self._car["brake_rear"],
        }

    def _steering(self) -> Values:
        return {
            "primary_steering_angular_rate": self._car.steer_rate * self._ratio,
            "commanded_steering_rate": self._car.steer_rate * self._ratio,
        }

    def _steering_angles(self) -> Values:
        primary, secondary = (self._sensors.steering() * self._ratio for _ in range(2))
        return {
            "primary_steering_angle_fbk": primary,
            "secondary_steering_ang_fdbk": secondary,
            "average_steering_ang_fdbk": 0.5 * (primary + secondary),
        }

    def _steering_motor(self) -> Values:
        duty = self._car.steer_rate / self._car.parameters.car.steer_rate
        return {
            "motor_duty_cycle_cmd": duty,
            "motor_duty_cycle_fbk": duty,
            "motor_current_fbk": 20.0 * abs(duty),
            "sbw_ecu_voltage": 12.6,
            "sbw_ecu_temp": AMBIENT_C + 15.0,
            "sbw_error_code": 0,
            "sbw_motor_torque_estimate": 5.0 * abs(duty),
        }

    def _misc(self) -> Values:
        return {
            "battery_voltage": 12.8,
            "sys_state": int(self._controller.state),
            "mode_switch_state": 1,
            "safety_switch_state": 0,
            "target_speed_multi_car_race": 0,
        }

    def _loads(self) -> Values:
        return {signal: self._car.output(load) for signal, load in LOADS}

    def _brake_positions(self) -> Values:
        asked = self._received.commands
        front, rear = (self._car[name] / 6e6 for name in ("brake_front", "brake_rear"))
        return {
            "F_brk_pos_cmd": 7500.0 * min(asked.brake_front / 6e6, 1.0),
            "F_brk_pos_fbk": 7500.0 * front,
            "R_brk_pos_cmd": 7500.0 * min(asked.brake_rear / 6e6, 1.0),
            "R_brk_pos_fbk": 7500.0 * rear,
        }

    def _brake_forces(self) -> Values:
        return {
            "f_brake_act_force": 4.0e-4 * self._car["brake_front"],
            "r_brake_act_force": 4.0e-4 * self._car["brake_rear"],
        }

    def _powertrain(self) -> Values:
        return {
            "engine_run_switch": 1,
            "engine_state": int(self._controller.engine_running),
            "throttle_position": self._car["throttle"],
            "current_gear": self._car.gear,
            "engine_speed": self._car.output("engine_speed") if self._controller.engine_running else 0.0,
            "vehicle_speed": abs(self._car["vx"]),
            "gear_shift_status": int(self._car.shifting > 0),
        }

    def _fluids(self) -> Values:
        running = self._controller.engine_running
        return {
            "fuel_pressure": 350e3 * running,
            "engine_oil_pressure": 420e3 * running,
            "coolant_temperature": 85.0 if running else AMBIENT_C,
            "transmission_temperature": 70.0 if running else AMBIENT_C,
            "transmission_pressure": 300e3 * running,
        }

    def _torque(self) -> Values:
        return {
            "engine_oil_temperature": 95.0 if self._controller.engine_running else AMBIENT_C,
            "torque_wheels": self._car.output("axle_torque"),
            "driver_traction_aim_swicth_fbk": 0,
            "driver_traction_range_switch_fbk": 0,
            "push2pass_status": 0,
            "push2pass_budget": 0,
            "push2pass_active_app_limit": 0,
        }

    def _diagnostics(self) -> Values:
        control = self._controller
        silent = float(control.state is SysState.EMERGENCY and control.cause == "commands silent")
        lost = float(not self._race_control.beating)
        return {**self._healthy, "est5_motec_comms_loss": silent, "adlink_hb_lost": silent, "rc_lost": lost}

    def _mylaps(self) -> Values:
        return {"mylaps_speed": abs(self._car["vx"]), "mylaps_heading": self._car["yaw"]}

    def _marelli(self) -> Values:
        return {
            "marelli_track_flag": self._race_control.track_flag,
            "marelli_vehicle_flag": self._race_control.vehicle_flag,
            "marelli_sector_flag": 0,
            "marelli_rc_base_sync_check": int(self._race_control.beating),
            "marelli_rc_lte_rssi": -60,
        }

    def _base(self) -> Values:
        control = self._race_control
        control.heartbeat = (control.heartbeat + control.beating) % 16
        return {
            "base_to_car_heartbeat": control.heartbeat,
            "track_flag": control.track_flag,
            "veh_flag": control.vehicle_flag if control.vehicle_flag < 16 else 0,
            "veh_rank": 1,
            "round_target_speed": 0.0,
            "lap_count": self._referee.laps,
            "lap_distance": self._car.road.s,
        }

    def _timing(self) -> Values:
        times = self._referee.lap_times_s
        return {
            "laps": self._referee.laps,
            "lap_time": times[-1] if times else 0.0,
            "time_stamp": self._car.time_s,
        }


def _resting(name: str, unit: str) -> float:
    """Plausible value of a signal nothing in the simulation moves."""
    if unit == "degC":
        return 80.0 if "Tire" in name else AMBIENT_C
    return 100.0e3 if name == "intake_manifold_press_kPa" else 0.0


def _position(receiver: Sensors | StandaloneReceiver, latitude: str, longitude: str) -> Values:
    """A reading of a receiver, rad."""
    return dict(zip((latitude, longitude), receiver.position(), strict=True))
