"""What the controls of a gamepad are called: as those of a pair of VR controllers, where they have the same.

SDL knows some hundred pads and says of each which control is "A", the lower one of four, whatever is printed on it. A
pad that it does not know has axes, buttons and hats by number; an SDL mapping in the configuration names them.
"""

from __future__ import annotations

import math

STICKS = (("left_stick_x", "left_stick_y"), ("right_stick_x", "right_stick_y"))
TRIGGERS = ("left_trigger", "right_trigger")

AXES = (*STICKS[0], *STICKS[1], *TRIGGERS)
"""By SDL's number of the axis."""

BUTTONS = (
    "right_primary", "right_secondary", "left_primary", "left_secondary",  # A B X Y
    "back", "guide", "start", "left_stick_click", "right_stick_click", "left_bumper", "right_bumper",
    "dpad_up", "dpad_down", "dpad_left", "dpad_right",
)  # fmt: skip
"""By SDL's number of the button."""

CONTROLS = (*AXES, *BUTTONS)

FULL = 32767
"""SDL's number for a stick or trigger at its end."""


def axis(number: int, value: int) -> float:
    """Return what a stick (-1..1) or a trigger (0..1) shows; x is positive to the right, y forward."""
    shown = max(-1.0, min(1.0, value / FULL))
    return 0.0 - shown if AXES[number].endswith("_y") else shown  # SDL's y is positive towards the person


def apply_dead_band(shown: dict[str, float], band: float) -> None:
    """Make sticks and triggers rise from zero at the edge of a dead band, a part of the way; a stick's is round."""
    for controls in (*STICKS, *((trigger,) for trigger in TRIGGERS)):
        size = math.hypot(*(shown[control] for control in controls))
        beyond = max(0.0, min(1.0, size) - band) / (1.0 - band)
        factor = beyond / size if size else 0.0
        for control in controls:
            shown[control] *= factor
