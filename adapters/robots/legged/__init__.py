"""Robots on legs, in one adapter and a table: what Unitree's quadrupeds and humanoids differ in is data."""
