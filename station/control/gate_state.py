"""The states of a gate (`station.control.gate`), and what they have in common."""

from __future__ import annotations

from typing import Literal

State = Literal["waiting", "entering", "tracking", "holding", "returning", "stopped", "faulted"]

MOVING: tuple[State, ...] = ("entering", "tracking")
"""A good command of this moment is followed."""

FOLLOWING: tuple[State, ...] = (*MOVING, "holding")
"""There is a commander, who decides where the robot is, be it by falling silent a moment ago."""

LATCHED: tuple[State, ...] = ("stopped", "faulted")
"""Left by `station.control.gate.Gate.reset` alone."""
