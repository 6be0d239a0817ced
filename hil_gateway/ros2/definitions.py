"""Message definitions that no ROS distribution has, by package and generation of the car's software.

Fields in order, as the packages define them; comments and constants are not in a type's hash. Sources: can_msgs (BSD),
raptor_dbw_msgs (BSD-2), deep_orange_msgs (Apache-2.0), ackermann_msgs (BSD). av24: Cavalier's set of 2025; av21:
MIT-PITT's of 2024, whose brake and steering reports are also those of Black and Gold and of dSPACE's simulator.
"""

from __future__ import annotations

from collections.abc import Mapping

COMMON: Mapping[str, str] = {
    "can_msgs/msg/Frame": (
        "std_msgs/Header header; uint32 id; bool is_rtr; bool is_extended; bool is_error; uint8 dlc; uint8[8] data"
    ),
    "raptor_dbw_msgs/msg/ActuatorControlMode": "uint8 value",
    "raptor_dbw_msgs/msg/ParkingBrake": "uint8 status",
    "raptor_dbw_msgs/msg/WheelSpeedReport": (
        "std_msgs/Header header; float32 front_left; float32 front_right; float32 rear_left; float32 rear_right"
    ),
    "raptor_dbw_msgs/msg/SteeringReport": (
        "std_msgs/Header header; float32 steering_wheel_angle; float32 steering_wheel_angle_cmd; float32 "
        "steering_wheel_torque; bool enabled; bool driver_activity; bool fault_steering_system; bool "
        "overheat_prevention_mode; uint8 rolling_counter; raptor_dbw_msgs/ActuatorControlMode control_type; bool "
        "steering_overheat_warning"
    ),
    "raptor_dbw_msgs/msg/AcceleratorPedalReport": (
        "std_msgs/Header header; float32 pedal_input; float32 pedal_output; bool enabled; bool ignore_driver; bool "
        "driver_activity; bool fault_accel_pedal_system; bool fault_ch1; bool fault_ch2; uint8 rolling_counter; "
        "float32 torque_actual; raptor_dbw_msgs/ActuatorControlMode control_type"
    ),
    "raptor_dbw_msgs/msg/SteeringCmd": (
        "float32 angle_cmd; float32 angle_velocity; bool enable; bool ignore; uint8 rolling_counter; float32 "
        "torque_cmd; float32 vehicle_curvature_cmd; raptor_dbw_msgs/ActuatorControlMode control_type"
    ),
    "raptor_dbw_msgs/msg/BrakeCmd": (
        "float32 pedal_cmd; bool enable; uint8 rolling_counter; float32 torque_cmd; float32 decel_limit; "
        "raptor_dbw_msgs/ActuatorControlMode control_type; float32 decel_negative_jerk_limit; "
        "raptor_dbw_msgs/ParkingBrake park_brake_cmd"
    ),
    "raptor_dbw_msgs/msg/AcceleratorPedalCmd": (
        "float32 pedal_cmd; float32 torque_cmd; float32 speed_cmd; bool enable; bool ignore; uint8 rolling_counter; "
        "float32 road_slope; raptor_dbw_msgs/ActuatorControlMode control_type; float32 accel_limit; float32 "
        "accel_positive_jerk_limit"
    ),
    "deep_orange_msgs/msg/MiscReport": (
        "builtin_interfaces/Time stamp; float32 battery_voltage; bool off_grid_power_connection; uint8 "
        "safety_switch_state; bool mode_switch_state; uint8 sys_state"
    ),
    "ackermann_msgs/msg/AckermannDrive": (
        "float32 steering_angle; float32 steering_angle_velocity; float32 speed; float32 acceleration; float32 jerk"
    ),
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header; ackermann_msgs/AckermannDrive drive",
}
GENERATIONS: Mapping[str, Mapping[str, str]] = {
    "av24": {
        "raptor_dbw_msgs/msg/Brake2Report": (
            "std_msgs/Header header; uint8 rolling_counter; float32 front_brake_pressure; float32 rear_brake_pressure"
        ),
        "raptor_dbw_msgs/msg/SteeringExtendedReport": (
            "std_msgs/Header header; uint8 steering_motor_fdbk_counter; int8 static_friction_compensation; int16 "
            "commanded_steering_rate; float32 average_steering_ang_fdbk; float32 secondary_steering_ang_fdbk; "
            "float32 primary_steering_angle_fbk; int8 motor_duty_cycle_cmd; int8 motor_duty_cycle_fbk; uint8 "
            "motor_current_fbk; uint8 sbw_ecu_voltage; uint8 sbw_ecu_temp; uint8 sbw_error_code; uint8 "
            "sbw_motor_torque_estimate"
        ),
        "deep_orange_msgs/msg/PtReport": (
            "builtin_interfaces/Time stamp; float32 map_sensor; float32 lambda_sensor; float32 fuel_level; float32 "
            "fuel_pressure; float32 engine_oil_pressure; float32 engine_oil_temperature; float32 "
            "engine_coolant_temperature; float32 engine_coolant_pressure; float32 engine_rpm; bool "
            "engine_on_status; bool engine_run_switch_status; float32 throttle_position; int8 current_gear; int8 "
            "gear_shift_status; float32 transmission_oil_pressure; float32 transmission_accumulator_pressure; "
            "float32 transmission_oil_temperature; float32 vehicle_speed_kmph; float32 torque_wheels; uint8 "
            "driver_traction_aim_switch_fbk; uint8 driver_traction_range_switch_fbk; uint8 push2pass_status; "
            "float32 push2pass_budget; float32 push2pass_active_app_limit"
        ),
    },
    "av21": {
        "raptor_dbw_msgs/msg/Brake2Report": (
            "std_msgs/Header header; float32 front_brake_pressure; float32 rear_brake_pressure; uint8 "
            "rolling_counter; float32 estimated_road_slope; float32 speed_set_point"
        ),
        "raptor_dbw_msgs/msg/SteeringExtendedReport": (
            "std_msgs/Header header; float32 steering_motor_ang_1; float32 steering_motor_ang_2; float32 "
            "steering_motor_ang_3"
        ),
        "deep_orange_msgs/msg/PtReport": (
            "builtin_interfaces/Time stamp; float32 map_sensor; float32 lambda_sensor; float32 fuel_level; float32 "
            "fuel_pressure; float32 engine_oil_pressure; float32 engine_oil_temperature; float32 "
            "engine_coolant_temperature; float32 engine_coolant_pressure; float32 engine_rpm; bool "
            "engine_on_status; bool engine_run_switch_status; float32 throttle_position; int8 current_gear; int8 "
            "gear_shift_status; float32 transmission_oil_pressure; float32 transmission_accumulator_pressure; "
            "float32 transmission_oil_temperature; float32 vehicle_speed_kmph; float32 torque_wheels; uint8 "
            "driver_traction_aim_switch; uint8 driver_traction_range_switch"
        ),
    },
}
