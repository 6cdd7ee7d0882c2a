"""What sticks, arrows and keys ask of the legs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from adapters.retarget.walking import FASTEST, FASTEST_BACK, HIGHEST_M, LOWEST_M, VelocityCommand

DEAD_BAND = 0.12
"""A stick nearer to its middle rests there."""

HEIGHT_RATE = 0.2
"""A height stick at its end lowers or raises the pelvis so fast [m/s]; it stays where it was left."""

_FORWARD = {"left_stick_y": 1.0, "key_w": 1.0, "key_s": -1.0}
_LEFT = {"left_stick_x": -1.0, "key_j": 1.0, "key_l": -1.0}
_TURN_LEFT = {"right_stick_x": -1.0, "key_a": 1.0, "key_d": -1.0}
_UP = {"right_stick_y": 1.0, "dpad_up": 1.0, "dpad_down": -1.0, "key_i": 1.0, "key_k": -1.0}


class Sticks:
    """Velocities from deflections, as stock TWIST2 reads them, and a height that stays where it was left."""

    def __init__(self) -> None:
        self.height = HIGHEST_M

    def wish(self, controls: Mapping[str, float], dt_s: float) -> VelocityCommand:
        """Return what controls ask for after a period [s]; one that is missing rests."""
        return self.deflected(*deflections(controls), dt_s)

    def deflected(self, forward: float, left: float, turn_left: float, up: float, dt_s: float) -> VelocityCommand:
        """Return what deflections from -1 to 1 ask for after a period [s]."""
        self.height = min(max(self.height + live(up) * HEIGHT_RATE * dt_s, LOWEST_M), HIGHEST_M)
        ahead = live(forward)
        fastest = FASTEST[0] if ahead > 0.0 else FASTEST_BACK
        sideways, turning = live(left) * FASTEST[1], live(turn_left) * FASTEST[2]
        return VelocityCommand(float(ahead * fastest), float(sideways), float(turning), self.height)

    def rest(self) -> VelocityCommand:
        """Return the wish to stand, as high as before."""
        return VelocityCommand(height=self.height)


def deflections(controls: Mapping[str, float]) -> tuple[float, float, float, float]:
    """Return how far controls are deflected forward, to the left, to turn left, and up."""
    forward, left, turn_left, up = (summed(controls, signs) for signs in (_FORWARD, _LEFT, _TURN_LEFT, _UP))
    return forward, left, turn_left, up


def summed(controls: Mapping[str, float], signs: Mapping[str, float]) -> float:
    """Return the sum of controls with their signs; one that is missing rests."""
    return sum(sign * controls.get(name, 0.0) for name, sign in signs.items())


def live(deflection: float) -> float:
    """Return a deflection without its dead band: zero in it, growing from zero beyond it, 1 at the end."""
    size = min(abs(deflection), 1.0)
    return float(np.sign(deflection)) * max(size - DEAD_BAND, 0.0) / (1.0 - DEAD_BAND)
