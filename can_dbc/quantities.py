"""What a car reports and can be asked for, by the names that the project uses; `signals.toml` says where each one is.

SI, signs of ISO 8855: x forward, y left, z up; steering and yaw positive to the left.
"""

from __future__ import annotations

from typing import NamedTuple


class Report(NamedTuple):
    """A quantity that the car reports."""

    unit: str
    source: str = ""
    """group of reports whose age counts together; empty: nothing depends on it"""
    required: bool = False


WHEELS = ("fl", "fr", "rl", "rr")
REPORTS: dict[str, Report] = {
    **{f"wheel_speed_{wheel}": Report("m/s", "wheel_speeds", required=True) for wheel in WHEELS},  # circumferential
    "steering_motor": Report("rad", "steering", required=True),  # what is steered with, of all its sensors
    "steering_motor_primary": Report("rad", "steering"),
    "steering_motor_secondary": Report("rad", "steering"),
    "steering_motor_rate": Report("rad/s", "steering"),
    "accelerator": Report("1", "pedals", required=True),
    "brake_front": Report("Pa", "pedals", required=True),
    "brake_rear": Report("Pa", "pedals", required=True),
    "gear": Report("1", "powertrain", required=True),  # 0: neutral
    "engine_speed": Report("rad/s", "powertrain", required=True),
    "throttle": Report("1", "powertrain"),
    "sys_state": Report("1", "vehicle", required=True),
    "mode_switch": Report("1", "vehicle"),  # 0: manual
    "safety_switch": Report("1", "vehicle"),  # not 0: pulled
    "battery_voltage": Report("V", "vehicle"),
    "heartbeat": Report("1", "race_control", required=True),
    "track_flag": Report("1", "race_control", required=True),
    "vehicle_flag": Report("1", "race_control", required=True),
    "target_speed": Report("m/s", "race_control"),  # 0: none
    "second_track_flag": Report("1", "race_control_flags"),  # of a second transmitter: the more restrictive one counts
    "second_vehicle_flag": Report("1", "race_control_flags"),
    "second_sector_flag": Report("1", "race_control_flags"),
    # what only people and the simulated car look at
    "speed": Report("m/s"),
    "engine_on": Report("1"),
    "engine_run_switch": Report("1"),
    "shifting": Report("1"),
    "axle_torque": Report("N m"),
    "fuel_pressure": Report("Pa"),
    "oil_pressure": Report("Pa"),
    "transmission_pressure": Report("Pa"),
    "coolant_temperature": Report("degC"),
    "oil_temperature": Report("degC"),
    "transmission_temperature": Report("degC"),
    **{f"load_{wheel}": Report("N") for wheel in WHEELS},
    "steering_motor_rate_asked": Report("rad/s"),
    "steering_duty_asked": Report("1"),
    "steering_duty": Report("1"),
    "steering_current": Report("A"),
    "steering_voltage": Report("V"),
    "steering_temperature": Report("degC"),
    "steering_torque": Report("N m"),
    "brake_position_front_asked": Report("1"),
    "brake_position_front": Report("1"),
    "brake_position_rear_asked": Report("1"),
    "brake_position_rear": Report("1"),
    "brake_force_front": Report("N"),
    "brake_force_rear": Report("N"),
    "commands_lost": Report("1"),
    "computer_lost": Report("1"),
    "race_control_lost": Report("1"),
    "race_control_heard": Report("1"),
    "signal_strength": Report("1"),  # dBm
    "rank": Report("1"),
    "lap": Report("1"),
    "laps": Report("1"),
    "lap_distance": Report("m"),
    "lap_time": Report("s"),
    "time": Report("s"),
    "timing_speed": Report("m/s"),
    "timing_heading": Report("rad"),
}
IMU: dict[str, Report] = {
    "ax": Report("m/s2", required=True),  # specific force, as mounted
    "ay": Report("m/s2", required=True),
    "az": Report("m/s2", required=True),
    "yaw_rate": Report("rad/s", required=True),
    "roll_rate": Report("rad/s"),
    "pitch_rate": Report("rad/s"),
}
"""of one inertial sensor: `imu.NAME.ax`"""
RECEIVER: dict[str, Report] = {
    "latitude": Report("rad", required=True),
    "longitude": Report("rad", required=True),
}
"""of one satellite receiver: `receiver.NAME.latitude`"""
TYRE: dict[str, Report] = {
    "pressure": Report("Pa"),  # from vacuum
    "gauge": Report("Pa"),  # over the air outside
}
"""of one tyre: `tyre.fl.pressure`; and `tyre.fl.temperature.0` and on, degC, over the width of the tread"""
TEMPERATURE = Report("degC")
FAILURE = Report("1")
"""`failure.SIGNAL`: not 0 is a failure of the car"""


class Command(NamedTuple):
    """A quantity that the car is asked for."""

    unit: str
    actuator: bool = False
    """sent while the car is driven; the others say what the computer does, and are always sent"""
    required: bool = False


COMMANDS: dict[str, Command] = {  # in the order in which they leave: brakes before the accelerator that waits for them
    "steering_motor": Command("rad", actuator=True, required=True),
    "brake_front": Command("Pa", actuator=True, required=True),
    "brake_rear": Command("Pa", actuator=True),  # absent: the rear brakes follow the front ones by the declared bias
    "accelerator": Command("1", actuator=True, required=True),
    "gear": Command("1", actuator=True, required=True),
    "ct_state": Command("1", required=True),
    "vehicle_number": Command("1"),
    "track_flag_ack": Command("1"),
    "vehicle_flag_ack": Command("1"),
    "second_track_flag_ack": Command("1"),
    "second_vehicle_flag_ack": Command("1"),
    "second_sector_flag_ack": Command("1"),
}

CODES: dict[str, tuple[tuple[str, ...], frozenset[str]]] = {
    "ct_state": (
        ("power_on", "init", "actuator_test", "crank_ready", "cranking", "race_ready", "init_driving", "caution",
         "nominal_race", "coordinated_stop", "controlled_shutdown", "emergency"),
        frozenset({"init", "crank_ready", "cranking", "race_ready", "nominal_race", "controlled_shutdown",
                   "emergency"}),
    ),
    "sys_state": (
        ("power_on", "connected", "testing", "test_done", "crank_ready", "pre_crank", "cranking", "idle", "driving",
         "shut_engine", "emergency", "critical_limit"),
        frozenset({"connected", "crank_ready", "idle", "driving", "emergency"}),
    ),
    "track_flag": (("none", "green", "red", "checkered", "full_course_yellow"), frozenset({"green", "red"})),
    "vehicle_flag": (("none", "black", "yellow", "purple", "e_kill", "stop"), frozenset({"none", "e_kill"})),
}  # fmt: skip
"""Coded quantity -> meanings in order of the ladder, and those that every car has."""
