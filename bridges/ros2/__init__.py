"""The ROS 2 side of the bridge: one file, for the user's own ROS Python."""
