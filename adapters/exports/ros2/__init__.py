"""Episodes as ROS 2 bags: MCAP files of ROS messages that ros2 bag, rosbags, PlotJuggler, Foxglove and Rerun open."""
