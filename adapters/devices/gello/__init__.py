"""GELLO leader arms: a chain of Dynamixel or Feetech servos on a serial port."""
