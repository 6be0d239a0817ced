"""What a car reports and can be asked for, by the names that the project uses; `signals.toml` says where each one is.

SI, signs of ISO 8855: x forward, y left, z up; steering and yaw positive to the left.
"""

from __future__ import annotations

from typing import NamedTuple


class ReportedQuantity(NamedTuple):
    """A quantity that the car reports."""

    unit: str
    source: str = ""
    """group of reports whose age counts together; empty: nothing depends on it"""
    required: bool = False


WHEELS = ("fl", "fr", "rl", "rr")
REPORTS: dict[str, ReportedQuantity] = {
    **{
        f"wheel_speed_{wheel}": ReportedQuantity("m/s", "wheel_speeds", required=True) for wheel in WHEELS
    },  # circumferential
    "steering_motor": ReportedQuantity("rad", "steering", required=True),  # what is steered with, of all its sensors
    "steering_motor_primary": ReportedQuantity("rad", "steering"),
    "steering_motor_secondary": ReportedQuantity("rad", "steering"),
    "steering_motor_rate": ReportedQuantity("rad/s", "steering"),
    "accelerator": ReportedQuantity("1", "pedals", required=True),
    "brake_front": ReportedQuantity("Pa", "pedals", required=True),
    "brake_rear": ReportedQuantity("Pa", "pedals", required=True),
    "gear": ReportedQuantity("1", "powertrain", required=True),  # 0: neutral
    "engine_speed": ReportedQuantity("rad/s", "powertrain", required=True),
    "throttle": ReportedQuantity("1", "powertrain"),
    "sys_state": ReportedQuantity("1", "vehicle", required=True),
    "mode_switch": ReportedQuantity("1", "vehicle"),  # 0: manual
    "safety_switch": ReportedQuantity("1", "vehicle"),  # not 0: pulled
    "battery_voltage": ReportedQuantity("V", "vehicle"),
    "heartbeat": ReportedQuantity("1", "race_control", required=True),
    "track_flag": ReportedQuantity("1", "race_control", required=True),
    "vehicle_flag": ReportedQuantity("1", "race_control", required=True),
    "target_speed": ReportedQuantity("m/s", "race_control"),  # 0: none
    "second_track_flag": ReportedQuantity(
        "1", "race_control_flags"
    ),  # of a second transmitter: the more restrictive one counts
    "second_vehicle_flag": ReportedQuantity("1", "race_control_flags"),
    "second_sector_flag": ReportedQuantity("1", "race_control_flags"),
    # what only people and the simulated car look at
    "speed": ReportedQuantity("m/s"),
    "engine_on": ReportedQuantity("1"),
    "engine_run_switch": ReportedQuantity("1"),
    "shifting": ReportedQuantity("1"),
    "axle_torque": ReportedQuantity("N m"),
    "fuel_pressure": ReportedQuantity("Pa"),
    "oil_pressure": ReportedQuantity("Pa"),
    "transmission_pressure": ReportedQuantity("Pa"),
    "coolant_temperature": ReportedQuantity("degC"),
    "oil_temperature": ReportedQuantity("degC"),
    "transmission_temperature": ReportedQuantity("degC"),
    **{f"load_{wheel}": ReportedQuantity("N") for wheel in WHEELS},
    "steering_motor_rate_asked": ReportedQuantity("rad/s"),
    "steering_duty_asked": ReportedQuantity("1"),
    "steering_duty": ReportedQuantity("1"),
    "steering_current": ReportedQuantity("A"),
    "steering_voltage": ReportedQuantity("V"),
    "steering_temperature": ReportedQuantity("degC"),
    "steering_torque": ReportedQuantity("N m"),
    "brake_position_front_asked": ReportedQuantity("1"),
    "brake_position_front": ReportedQuantity("1"),
    "brake_position_rear_asked": ReportedQuantity("1"),
    "brake_position_rear": ReportedQuantity("1"),
    "brake_force_front": ReportedQuantity("N"),
    "brake_force_rear": ReportedQuantity("N"),
    "commands_lost": ReportedQuantity("1"),
    "computer_lost": ReportedQuantity("1"),
    "race_control_lost": ReportedQuantity("1"),
    "race_control_heard": ReportedQuantity("1"),
    "signal_strength": ReportedQuantity("1"),  # dBm
    "rank": ReportedQuantity("1"),
    "lap": ReportedQuantity("1"),
    "laps": ReportedQuantity("1"),
    "lap_distance": ReportedQuantity("m"),
    "lap_time": ReportedQuantity("s"),
    "time": ReportedQuantity("s"),
    "timing_speed": ReportedQuantity("m/s"),
    "timing_heading": ReportedQuantity("rad"),
}
IMU: dict[str, ReportedQuantity] = {
    "ax": ReportedQuantity("m/s2", required=True),  # specific force, as mounted
    "ay": ReportedQuantity("m/s2", required=True),
    "az": ReportedQuantity("m/s2", required=True),
    "yaw_rate": ReportedQuantity("rad/s", required=True),
    "roll_rate": ReportedQuantity("rad/s"),
    "pitch_rate": ReportedQuantity("rad/s"),
}
"""of one inertial sensor: `imu.NAME.ax`"""
RECEIVER: dict[str, ReportedQuantity] = {
    "latitude": ReportedQuantity("rad", required=True),
    "longitude": ReportedQuantity("rad", required=True),
}
"""of one satellite receiver: `receiver.NAME.latitude`"""
TYRE: dict[str, ReportedQuantity] = {
    "pressure": ReportedQuantity("Pa"),  # from vacuum
    "gauge": ReportedQuantity("Pa"),  # over the air outside
}
"""of one tyre: `tyre.fl.pressure`; and `tyre.fl.temperature.0` and on, degC, over the width of the tread"""
TEMPERATURE = ReportedQuantity("degC")
FAILURE = ReportedQuantity("1")
"""`failure.SIGNAL`: not 0 is a failure of the car"""


class CommandedQuantity(NamedTuple):
    """A quantity that the car is asked for."""

    unit: str
    actuator: bool = False
    """sent while the car is driven; the others say what the computer does, and are always sent"""
    required: bool = False


COMMANDS: dict[
    str, CommandedQuantity
] = {  # in the order in which they leave: brakes before the accelerator that waits for them
    "steering_motor": CommandedQuantity("rad", actuator=True, required=True),
    "brake_front": CommandedQuantity("Pa", actuator=True, required=True),
    "brake_rear": CommandedQuantity(
        "Pa", actuator=True
    ),  # absent: the rear brakes follow the front ones by the declared bias
    "accelerator": CommandedQuantity("1", actuator=True, required=True),
    "gear": CommandedQuantity("1", actuator=True, required=True),
    "ct_state": CommandedQuantity("1", required=True),
    "vehicle_number": CommandedQuantity("1"),
    "track_flag_ack": CommandedQuantity("1"),
    "vehicle_flag_ack": CommandedQuantity("1"),
    "second_track_flag_ack": CommandedQuantity("1"),
    "second_vehicle_flag_ack": CommandedQuantity("1"),
    "second_sector_flag_ack": CommandedQuantity("1"),
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
