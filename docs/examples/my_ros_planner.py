"""Drive with a planner of your own over ROS 2, through the gateway's arming, limits and failsafe.

    HIL_ROS2__COMMANDS=ackermann hil ros2 run &          # beside plant, gateway and estimator
    python docs/examples/my_ros_planner.py [TRACK] &     # where rclpy, nav_msgs and ackermann_msgs are installed
    hil gateway crank && hil gateway arm

It follows the middle of the road at 10 m/s: odometry in, one AckermannDriveStamped out for each.
"""

import math
import sys
from typing import Any

from hil_gateway.config import load_config
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

SPEED, WALKING, AHEAD = 10.0, 1.5, 12.0  # m/s, m/s, m


class Follower:
    """Pure pursuit of the middle of the road."""

    def __init__(self, track: Track, wheelbase: float, speed: float = SPEED) -> None:
        self.track, self.wheelbase, self.speed = track, wheelbase, speed

    def answer(self, odometry: Any) -> tuple[float, float]:
        """Road-wheel angle (rad) and speed (m/s) for a nav_msgs/Odometry in `map`; there is none before the car has
        moved by some metres, which show where it points: straight on, at walking pace."""
        if odometry is None:
            return 0.0, WALKING
        at, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
        goal = self.track.at(self.track.project(at.x, at.y)[0] + AHEAD)
        yaw = 2.0 * math.atan2(turn.z, turn.w)
        across = math.sin(math.atan2(goal.y - at.y, goal.x - at.x) - yaw)
        return math.atan(2.0 * self.wheelbase * across / AHEAD), self.speed


def main() -> None:
    """The node: what comes from `rclpy` and nothing else."""
    import rclpy
    from ackermann_msgs.msg import AckermannDriveStamped
    from nav_msgs.msg import Odometry

    config = load_config(None)
    follower = Follower(load_track(sys.argv[1] if len(sys.argv) > 1 else config.track), config.vehicle.wheelbase)
    rclpy.init()
    node, newest = rclpy.create_node("my_planner"), [None]
    commands = node.create_publisher(AckermannDriveStamped, "/av24/ackermann_cmd", 10)

    def command() -> None:
        message = AckermannDriveStamped()
        if newest[0] is not None:
            message.header.stamp = newest[0].header.stamp  # the gateway ages a command from what it answers
        message.drive.steering_angle, message.drive.speed = follower.answer(newest[0])
        commands.publish(message)

    node.create_subscription(Odometry, "/av24/odometry", lambda odometry: newest.__setitem__(0, odometry), 10)
    node.create_timer(0.05, command)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
