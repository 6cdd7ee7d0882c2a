"""GELLO leader arms: a chain of Dynamixel servos on a serial port."""
