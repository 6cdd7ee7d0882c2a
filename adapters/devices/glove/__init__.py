"""Sensor gloves: how far fingers are closed, as lines of numbers on a serial port."""
