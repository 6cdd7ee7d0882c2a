"""Episodes as ROS 2 bags: MCAP files of ROS messages in the form that ros2 bag has (docs/ros2-bags.md)."""
