"""A car played onto a CAN interface by canplayer, from a log that cantools encoded with our DBC."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cantools

from can_dbc.folder import SHIPPED

PEER = cantools.database.load_file(SHIPPED / "av24/av24.dbc")
LOG_PERIODS = 256
"""Length of the played log: every 8-bit counter is back where it began."""

REPORTS: dict[str, dict[str, float]] = {
    "imu_1": {"imu_yaw_rate": 1.5, "imu_ay": 0.01},
    "imu_2": {"imu_roll_rate": -0.5, "imu_ax": 0.02},
    "imu_3": {"imu_az": 1.0},
    "wheel_speed_report": {"wheel_speed_FL": 1.1, "wheel_speed_FR": 1.2, "wheel_speed_RL": 1.3, "wheel_speed_RR": 1.4},
    "brake_pressure_report": {"brake_pressure_fdbk_front": 310, "brake_pressure_fdbk_rear": 270},
    "accelerator_report": {"acc_pedal_fdbk": 4.2},
    "steering_report": {"primary_steering_angular_rate": 0.0, "commanded_steering_rate": 0.0},
    "steering_report_extd": {
        "primary_steering_angle_fbk": 12.0, "secondary_steering_ang_fdbk": 12.5, "average_steering_ang_fdbk": 12.0,
    },
    "steering_report_extd_2": {},
    "misc_report": {"battery_voltage": 13.1, "sys_state": 9, "mode_switch_state": 1},
    "pt_report_1": {"engine_speed_rpm": 1500, "current_gear": 1, "throttle_position": 7.5, "engine_state": 1},
    "novatel_report": {"novatel_lat": 36.585, "novatel_long": -121.753},
    "base_to_car_summary": {"track_flag": 1},
    "marelli_report_1": {"marelli_track_flag": 1},
    "diagnostic_report": {},
}  # fmt: skip
"""What the played car says, DBC units; counters and heartbeat run by themselves."""
COUNTERS = {
    "brake_pressure_report": "brk_pressure_fdbk_counter", "accelerator_report": "acc_pedal_fdbk_counter",
    "steering_report": "steering_motor_fdbk_counter", "misc_report": "raptor_rolling_counter",
    "base_to_car_summary": "base_to_car_heartbeat",
}  # fmt: skip
SLOW = {"novatel_report": 5, "base_to_car_summary": 8, "marelli_report_1": 8}
"""message -> 10 ms periods between its frames (dividing the log)"""


def write_log(path: Path, channel: str) -> None:
    """A candump log of the car, 10 ms a period."""
    lines = []
    for period in range(LOG_PERIODS):
        for offset, (name, values) in enumerate(REPORTS.items()):
            if period % SLOW.get(name, 1):
                continue
            message = PEER.get_message_by_name(name)
            filled = dict.fromkeys((s.name for s in message.signals), 0) | values
            if name in COUNTERS:
                filled[COUNTERS[name]] = period // SLOW.get(name, 1) % (16 if name in SLOW else 256)
            data = message.encode(filled, strict=False).hex().upper()
            lines.append(f"({1000 + period * 0.01 + offset * 1e-4:.6f}) {channel} {message.frame_id:03X}#{data}")
    path.write_text("\n".join(lines) + "\n")


@contextmanager
def played_car(log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(["canplayer", "-I", str(log), "-l", "i"], stdout=subprocess.DEVNULL) as player:
        try:
            yield player
        finally:
            player.kill()
