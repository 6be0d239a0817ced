"""ROS 2 bags: their files, their messages as bytes, and what those say."""
