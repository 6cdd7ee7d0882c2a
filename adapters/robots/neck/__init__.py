"""A neck of two Dynamixel servos on a serial port, as TWIST2's robot has: a robot of its own."""
