"""Definitions of messages that bags up to ROS 2 Humble do not hold, by package and generation.

Fields in order, as the packages define them. Sources: raptor_dbw_msgs (BSD-2), deep_orange_msgs (Apache-2.0),
novatel_oem7_msgs and vectornav_msgs (MIT). Close generations decode each other's bytes without an error, so the
generation is found from many messages (`known_types`).
"""

from __future__ import annotations

from collections.abc import Mapping

from hil_gateway.ros2.definitions import COMMON, GENERATIONS

_ENUMS = {
    "SolutionStatus": "uint32 status",
    "PositionOrVelocityType": "uint32 type",
    "InertialSolutionStatus": "uint32 status",
    "INSExtendedSolutionStatus": "uint32 status",
    "BestExtendedSolutionStatus": "uint8 status",
    "SolutionSource": "uint8 source",
}
_OEM7_HEADER = (
    "string message_name; uint16 message_id; uint8 message_type; uint32 sequence_number; uint8 time_status; "
    "uint16 gps_week_number; uint32 gps_week_milliseconds"
)
_HEADER_ENDS = {
    "iac": "; uint8 idle_time",
    "oem7": "",
    "oem7_2023": "; uint32 receiver_status; uint8 idle_time",
    "oem7_2024": "; uint32 receiver_status; float32 idle_time",
}
"""what the header of every NovAtel message ends with: the Indy teams' package, and three of the maker's"""
_OEM7 = {
    "BESTPOS": (
        "SolutionStatus sol_status; PositionOrVelocityType pos_type; float64 lat; float64 lon; float64 hgt; float32 "
        "undulation; uint32 datum_id; float32 lat_stdev; float32 lon_stdev; float32 hgt_stdev; int8[4] stn_id; float32 "
        "diff_age; float32 sol_age; uint8 num_svs; uint8 num_sol_svs; uint8 num_sol_l1_svs; uint8 num_sol_multi_svs; "
        "uint8 reserved; BestExtendedSolutionStatus ext_sol_stat; uint8 galileo_beidou_sig_mask; uint8 "
        "gps_glonass_sig_mask"
    ),
    "BESTVEL": (
        "SolutionStatus sol_status; PositionOrVelocityType vel_type; float32 latency; float32 diff_age; float64 "
        "hor_speed; float64 trk_gnd; float64 ver_speed; float32 reserved"
    ),
    "HEADING2": (
        "SolutionStatus sol_status; PositionOrVelocityType pos_type; float32 length; float32 heading; float32 pitch; "
        "float32 reserved; float32 heading_stdev; float32 pitch_stdev; int8[4] rover_stn_id; int8[4] master_stn_id; "
        "uint8 num_sv_tracked; uint8 num_sv_in_sol; uint8 num_sv_obs; uint8 num_sv_multi; SolutionSource sol_source; "
        "BestExtendedSolutionStatus ext_sol_status; uint8 galileo_beidou_sig_mask; uint8 gps_glonass_sig_mask"
    ),
    "INSPVA": (
        "float64 latitude; float64 longitude; float64 height; float64 north_velocity; float64 east_velocity; float64 "
        "up_velocity; float64 roll; float64 pitch; float64 azimuth; InertialSolutionStatus status"
    ),
    "INSPVAX": (
        "InertialSolutionStatus ins_status; PositionOrVelocityType pos_type; float64 latitude; float64 longitude; "
        "float64 height; float32 undulation; float64 north_velocity; float64 east_velocity; float64 up_velocity; "
        "float64 roll; float64 pitch; float64 azimuth; float32 latitude_stdev; float32 longitude_stdev; float32 "
        "height_stdev; float32 north_velocity_stdev; float32 east_velocity_stdev; float32 up_velocity_stdev; float32 "
        "roll_stdev; float32 pitch_stdev; float32 azimuth_stdev; INSExtendedSolutionStatus ext_sol_status; uint16 "
        "time_since_update"
    ),
    "CORRIMU": (
        "uint32 imu_data_count; float64 pitch_rate; float64 roll_rate; float64 yaw_rate; float64 lateral_acc; float64 "
        "longitudinal_acc; float64 vertical_acc; uint32 reserved1; uint32 reserved2"
    ),
    "IMURATECORRIMU": (
        "uint32 week; float64 seconds; float64 pitch_rate; float64 roll_rate; float64 yaw_rate; float64 lateral_acc; "
        "float64 longitudinal_acc; float64 vertical_acc"
    ),
    "RAWIMU": (
        "uint32 gnss_week; float64 gnss_seconds; uint32 status; geometry_msgs/Vector3 linear_acceleration; "
        "geometry_msgs/Vector3 angular_velocity"
    ),
}
"""behind both headers"""
_VECTORNAV = {
    "InsStatus": (
        "uint8 mode; bool gps_fix; bool time_error; bool imu_error; bool mag_pres_error; bool gps_error; bool "
        "gps_heading_ins; bool gps_compass"
    ),
    "CommonGroup": (
        "std_msgs/Header header; uint16 group_fields; uint64 timestartup; uint64 timegps; uint64 timesyncin; "
        "geometry_msgs/Vector3 yawpitchroll; geometry_msgs/Quaternion quaternion; geometry_msgs/Vector3 angularrate; "
        "geometry_msgs/Point position; geometry_msgs/Vector3 velocity; geometry_msgs/Vector3 accel; "
        "geometry_msgs/Vector3 imu_accel; geometry_msgs/Vector3 imu_rate; geometry_msgs/Vector3 magpres_mag; float32 "
        "magpres_temp; float32 magpres_pres; float32 deltatheta_dtime; geometry_msgs/Vector3 deltatheta_dtheta; "
        "geometry_msgs/Vector3 deltatheta_dvel; vectornav_msgs/InsStatus insstatus; uint32 syncincnt; uint16 timegpspps"
    ),
    "InsGroup": (
        "std_msgs/Header header; uint16 group_fields; vectornav_msgs/InsStatus insstatus; geometry_msgs/Point "
        "poslla; geometry_msgs/Point posecef; geometry_msgs/Vector3 velbody; geometry_msgs/Vector3 velned; "
        "geometry_msgs/Vector3 velecef; geometry_msgs/Vector3 magecef; geometry_msgs/Vector3 accelecef; "
        "geometry_msgs/Vector3 linearaccelecef; float32 posu; float32 velu"
    ),
}
_ENGINE = (
    "builtin_interfaces/Time stamp; float32 map_sensor; float32 lambda_sensor; float32 fuel_level; float32 "
    "fuel_pressure; float32 engine_oil_pressure; float32 engine_oil_temperature; float32 engine_coolant_temperature; "
    "float32 engine_coolant_pressure; float32 engine_rpm; bool engine_on_status; bool engine_run_switch_status; "
    "float32 throttle_position; int8 current_gear; int8 gear_shift_status; float32 transmission_oil_pressure; "
    "float32 transmission_accumulator_pressure; float32 transmission_oil_temperature; float32 vehicle_speed_kmph"
)
_SWITCHES = "uint8 driver_traction_aim_switch; uint8 driver_traction_range_switch"
_PT_ENDS = {
    "2021": "",
    "2022": "; float32 torque_wheels",
    "2023": f"; float32 torque_wheels; {_SWITCHES}",
    "2025": f"; float32 torque_wheels; {_SWITCHES}; uint8 push2pass; float32 budget; float32 active_app_limit",
}
"""what the engine's report ends with"""


def _oem7(generation: str) -> dict[str, str]:
    """Definitions of NovAtel's messages; one generation has texts where the others have four bytes."""
    texts = generation == "oem7"
    bodies = {name: body.replace("int8[4]", "string") if texts else body for name, body in _OEM7.items()}
    headers = "std_msgs/Header header; Oem7Header nov_header; "
    every = {name: headers + body for name, body in bodies.items()} | _ENUMS
    every["Oem7Header"] = _OEM7_HEADER + _HEADER_ENDS[generation]
    return {f"novatel_oem7_msgs/msg/{name}": fields for name, fields in every.items()}


KNOWN: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "novatel_oem7_msgs": {generation: _oem7(generation) for generation in _HEADER_ENDS},
    "raptor_dbw_msgs": {name: {**COMMON, **messages} for name, messages in GENERATIONS.items()},
    "vectornav_msgs": {"": {f"vectornav_msgs/msg/{name}": fields for name, fields in _VECTORNAV.items()}},
    "deep_orange_msgs": {year: {"deep_orange_msgs/msg/PtReport": _ENGINE + end} for year, end in _PT_ENDS.items()},
}
"""package -> generation -> message -> fields"""
