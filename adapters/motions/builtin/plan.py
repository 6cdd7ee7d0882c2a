"""What a walk is asked to be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from station.errors import ConfigError

SHORTEST_STEP_S = 0.3
"""From one footfall to the next [s]; faster, and a swing is over before the weight has shifted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkPlan:
    """Walking at one velocity for a while.

    The defaults were found with TWIST2 in the loop: with steps of 0.55 s it goes 70 % of the way backwards and 42 % to
    the right, with these 86 % and 92 %; a wider stance and a higher pelvis help a little.

    Attributes:
        velocity_x, velocity_y: Of the body, forward and to the left [m/s].
        yaw_rate: Of the body, to the left [rad/s].
        duration_s: How long this velocity is wished, ramps included [s].
        ramp_s: From the velocity before (or standing) to this one, and from the last one to standing [s].
        step_s: From one footfall to the next [s]; less where the ankles could not follow.
        double_support: Part of a step in which both feet carry.
        height: Of the pelvis above the floor [m]; lower where long steps need it.
        clearance: How high a swinging foot is lifted [m].
        width: Between the ankles of two feet side by side [m].
        arm_swing: How far the arms swing; 1 is natural, 0 leaves them still.
        first_foot: Which foot begins; "auto" takes the one on the side of the motion.
    """

    velocity_x: float = 0.0
    velocity_y: float = 0.0
    yaw_rate: float = 0.0
    duration_s: float = 4.0
    ramp_s: float = 0.8
    step_s: float = 0.45
    double_support: float = 0.2
    height: float = 0.775
    clearance: float = 0.06
    width: float = 0.22
    arm_swing: float = 1.0
    first_foot: Literal["auto", "left", "right"] = "auto"

    def __post_init__(self) -> None:
        for name, lower, upper in _RANGES:
            value = getattr(self, name)
            if not lower <= value <= upper:
                raise ConfigError(f"walk plan: {name} is {value}; expected {lower:g} to {upper:g}")
        if self.duration_s < self.ramp_s:
            raise ConfigError(f"walk plan: duration_s {self.duration_s} is shorter than ramp_s {self.ramp_s}")

    @property
    def first_side(self) -> int:
        """0 when the left foot begins, 1 for the right: outwards first, so that feet do not cross."""
        if self.first_foot != "auto":
            return 0 if self.first_foot == "left" else 1
        outward = self.velocity_y if abs(self.velocity_y) > 1e-9 else self.yaw_rate
        return 0 if outward >= 0.0 else 1


_RANGES = (
    ("velocity_x", -0.6, 1.0),
    ("velocity_y", -0.4, 0.4),
    ("yaw_rate", -1.2, 1.2),
    ("duration_s", 0.1, 600.0),
    ("ramp_s", 0.1, 10.0),
    ("step_s", SHORTEST_STEP_S, 1.0),
    ("double_support", 0.1, 0.5),
    ("height", 0.6, 0.79),
    ("clearance", 0.01, 0.12),
    ("width", 0.17, 0.35),
    ("arm_swing", 0.0, 2.0),
)
"""What the legs can do with the other values at their defaults; a combination beyond that is refused by the legs."""
