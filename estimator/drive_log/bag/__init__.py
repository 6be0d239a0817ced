"""ROS 2 bags of drive messages as a drive log."""
