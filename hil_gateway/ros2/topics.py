"""Every topic of the bridge once: name, type, QoS. What is said of them in docs/ros2.md follows this table."""

from __future__ import annotations

from dataclasses import dataclass

from hil_gateway.ros2.wire import Qos

RELIABLE = Qos(depth=10)


@dataclass(frozen=True, slots=True)
class RosTopic:
    """One stream of messages on the ROS side."""

    name: str
    type: str
    qos: Qos = RELIABLE


NODE = "av24_bridge"
"""name of the bridge in the graph"""
RAPTOR = "/raptor_dbw_interface"
"""namespace of the drive-by-wire node in the teams' launch files"""

ODOMETRY = RosTopic("/av24/odometry", "nav_msgs/msg/Odometry")
IMU = RosTopic("/av24/imu", "sensor_msgs/msg/Imu")
PLAN = RosTopic("/av24/plan", "nav_msgs/msg/Path")
TF = RosTopic("/tf", "tf2_msgs/msg/TFMessage", Qos(depth=100))
TF_STATIC = RosTopic("/tf_static", "tf2_msgs/msg/TFMessage", Qos(depth=1, transient_local=True))
DIAGNOSTICS = RosTopic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
FRAMES = RosTopic("/from_can_bus", "can_msgs/msg/Frame", Qos(depth=500))
WHEEL_SPEEDS = RosTopic(f"{RAPTOR}/wheel_speed_report", "raptor_dbw_msgs/msg/WheelSpeedReport")
STEERING = RosTopic(f"{RAPTOR}/steering_report", "raptor_dbw_msgs/msg/SteeringReport")
ACCELERATOR = RosTopic(f"{RAPTOR}/accelerator_pedal_report", "raptor_dbw_msgs/msg/AcceleratorPedalReport")
BRAKES = RosTopic(f"{RAPTOR}/brake_2_report", "raptor_dbw_msgs/msg/Brake2Report")
ENGINE = RosTopic(f"{RAPTOR}/pt_report", "deep_orange_msgs/msg/PtReport")
REPORTS = (WHEEL_SPEEDS, STEERING, ACCELERATOR, BRAKES, ENGINE)
STATE = (ODOMETRY, IMU, PLAN, TF, TF_STATIC, DIAGNOSTICS, *REPORTS)

STEERING_CMD = RosTopic(f"{RAPTOR}/steering_cmd", "raptor_dbw_msgs/msg/SteeringCmd")
ACCELERATOR_CMD = RosTopic(f"{RAPTOR}/accelerator_pedal_cmd", "raptor_dbw_msgs/msg/AcceleratorPedalCmd")
BRAKE_CMD = RosTopic(f"{RAPTOR}/brake_cmd", "raptor_dbw_msgs/msg/BrakeCmd")
ACKERMANN_CMD = RosTopic("/av24/ackermann_cmd", "ackermann_msgs/msg/AckermannDriveStamped")

COMMANDS: dict[str, tuple[RosTopic, ...]] = {
    "none": (),
    "raptor": (STEERING_CMD, ACCELERATOR_CMD, BRAKE_CMD),
    "ackermann": (ACKERMANN_CMD,),
}
"""`ros2.commands` -> topics that are taken"""
