"""The remote of a Unitree G1 as an operator's device: what of it the robot tells in its states."""
