"""A running ROS 2 graph: the table that says which key is which topic, and messages both ways as bytes."""
