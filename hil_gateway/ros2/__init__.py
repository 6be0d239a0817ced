"""Bridge to ROS 2 in the wire format of `rmw_zenoh`: the car's state out, a team's commands in (docs/ros2.md)."""
