"""Gamepads, through SDL."""
