"""An arm that is caught behind the end of a joint's range is led back by way of the standing pose.

Somebody raises an arm at the side and lowers it in front. The robot's shoulder has two ways to hold its arm up, and
only one leads down in front; differential inverse kinematics, which never goes a way that is worse at first, would stay
at the end of the other for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from station.protocols import Floats

Way = Literal["follows", "frees", "returns"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RescueRules:
    """When an arm is led back.

    Attributes:
        caught_rad: An upper arm that points so far away from where it shall ...
        caught_s: ... for so long is caught [s]; an arm that only catches up with a leap is there sooner.
        free_rad: Every joint of the arm so near the standing pose: it is free.
        good_rad: So near where it shall point: it follows again.
        longest_s: No way takes longer [s].
        other_rad: Where freeing has not helped, it is not tried again before the arm is asked to point elsewhere.
        speed_rad_s: Greatest speed of the arm's joints on the way [rad/s]: nobody asked for these motions.
    """

    caught_rad: float = 0.6
    caught_s: float = 0.4
    free_rad: float = 0.3
    good_rad: float = 0.2
    longest_s: float = 2.0
    other_rad: float = 0.5
    speed_rad_s: float = 5.0


class ArmRescue:
    """Watches one arm; says when it follows, frees itself, and returns.

    Args:
        rules: When it is led back.
    """

    def __init__(self, rules: RescueRules | None = None) -> None:
        self.rules = rules or RescueRules()
        self.reset()

    def reset(self) -> None:
        """Forget everything: the arm follows."""
        self.way: Way = "follows"
        self.rescues = 0
        """How often the arm was led back."""
        self._since_s = 0.0
        self._tried: Floats | None = None

    def step(self, wanted: Floats, found: Floats, away_rad: float, dt_s: float) -> Way:
        """Return what the arm does in the next frame.

        Args:
            wanted: Where the upper arm shall point, a unit vector, shape (3,).
            found: Where it points, likewise.
            away_rad: How far the arm's joints are from the standing pose, the greatest [rad].
            dt_s: Time since the last frame [s].
        """
        rules, off = self.rules, _angle(wanted, found)
        self._since_s += dt_s
        if self.way == "follows":
            if off < rules.good_rad:
                self._tried = None
            was_tried = self._tried is not None and _angle(self._tried, wanted) < rules.other_rad
            if off < rules.caught_rad or was_tried:
                self._since_s = 0.0
            elif self._since_s > rules.caught_s:
                self._tried = wanted.copy()
                self.rescues += 1
                self._go("frees")
        elif self.way == "frees":
            if away_rad < rules.free_rad or self._since_s > rules.longest_s:
                self._go("returns")
        elif off < rules.good_rad or self._since_s > rules.longest_s:
            self._go("follows")
        return self.way

    def _go(self, way: Way) -> None:
        self.way, self._since_s = way, 0.0


def _angle(first: Floats, second: Floats) -> float:
    return float(np.arccos(np.clip(first @ second, -1.0, 1.0)))
