"""The ROS 2 bridge: tables, and messages against a library that made none of ours."""
