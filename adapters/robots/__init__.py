"""Robots, simulated and real."""
