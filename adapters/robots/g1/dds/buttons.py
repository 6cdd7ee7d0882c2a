"""Buttons of a G1's remote. Source: ``unitree_joystick.hpp`` of unitreerobotics/unitree_sdk2."""

BUTTONS = (
    "R1", "L1", "start", "select", "R2", "L2", "F1", "F2", "A", "B", "X", "Y", "up", "right", "down", "left",
)  # fmt: skip
"""In the order of their bits."""
