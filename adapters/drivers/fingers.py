"""Both Dex3-1 hands by triggers and grips, as in stock TWIST2: the trigger closes, the grip opens."""

from __future__ import annotations

from collections.abc import Mapping

from adapters.commands.g1_parts import hand
from adapters.robots.g1 import twist_keys
from station.operator.sample import Side
from station.protocols import Floats

CLOSING_RATE = 5.0
"""Part of the whole way per second; stock TWIST2 goes 0.05 of it in each of 100 ticks a second."""

OPENS_BOTH = "right_bumper"
"""Of a gamepad, which has no grips."""

_TOUCHED = 0.1  # a trigger that is less deflected rests

CLOSED: dict[Side, Floats] = {"left": hand("left", "").closed, "right": hand("right", "").closed}
"""Joints of a closed hand in the order of its motors [rad]; an open one is all zeros."""


class Fingers:
    """How far each hand is closed: 0 open, 1 closed."""

    def __init__(self) -> None:
        self.closed: dict[Side, float] = {"left": 0.0, "right": 0.0}

    def step(self, controls: Mapping[str, float], dt_s: float) -> None:
        """Close by triggers and open by grips for a period [s]."""
        for side in self.closed:
            closes = controls.get(f"{side}_trigger", 0.0) > _TOUCHED
            opens = max(controls.get(f"{side}_grip", 0.0), controls.get(OPENS_BOTH, 0.0)) > _TOUCHED
            way = closes - opens
            self.closed[side] = min(max(self.closed[side] + way * CLOSING_RATE * dt_s, 0.0), 1.0)

    def follow(self, side: Side, goal: float, dt_s: float) -> None:
        """Go towards a part of closing from 0 to 1, no faster than triggers do, for a period [s]."""
        change = CLOSING_RATE * dt_s
        way = min(max(goal - self.closed[side], -change), change)
        self.closed[side] = min(max(self.closed[side] + way, 0.0), 1.0)

    @property
    def commands(self) -> dict[str, Floats]:
        """Joints of both hands by bus key, shape (7,) [rad]."""
        return {twist_keys.action_hand(side): self.closed[side] * CLOSED[side] for side in self.closed}
