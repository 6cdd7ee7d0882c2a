"""How a stream of targets is tracked: the five numbers that go with every moveJ, under a name.

Which tracking type is stable is the question that a whole report was about; so the numbers are never in the code of the
loop. They have a name, the name is in the state and in every episode, and it can be changed at standstill.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Tracking = Literal["time", "joint-speed"]
Blend = Literal["none", "time"]
Overlay = Literal["via-point", "stop-point"]


@dataclass(frozen=True, kw_only=True)
class Profile:
    """What goes with each target of a stream.

    Attributes:
        name: As in the state, on the command line and in episodes.
        tracking: ``time``: arrive in `tracking_value` seconds (TT_TIME). ``joint-speed``: move at `tracking_value`
            rad/s (TT_JS_TARGET_SPEED), so a far target takes long instead of being refused.
        tracking_value: In [s] or [rad/s], see `tracking`; a speed is within the `Limits.qd_max` of every joint.
        blend: ``time``: pass from one motion into the next within `blend_s`; ``none``: do not.
        blend_s: Blend time [s].
        overlay: ``via-point``: a new target replaces the rest of the running motion (OT_VIAPOINT). ``stop-point``: it
            waits until the running motion has come to rest at its own target (OT_STOPPOINT).
        throttle: A target is sent on every so-manieth tick of 4 ms; 2 is 125 Hz.
        offset_guard: Whether a target further away than the arm can go in `tracking_value` seconds is approached in
            steps that it can. Without it such a target ends the connection (event 3002).
        guard_qdd_radps2: The acceleration that the controller's motion constraints allow a joint [rad/s²]; the guard's
            measure. KORD.ini's example by default.
        sim_only: Whether it is refused on a real robot.
    """

    name: str
    tracking: Tracking
    tracking_value: float
    blend: Blend = "time"
    blend_s: float = 0.0
    overlay: Overlay = "via-point"
    throttle: int = 2
    offset_guard: bool = False
    guard_qdd_radps2: float = math.radians(10_000)
    sim_only: bool = False


_ALL = (
    Profile(name="speed125", tracking="joint-speed", tracking_value=0.3, blend_s=0.008),
    Profile(name="time125", tracking="time", tracking_value=0.016, blend_s=0.008, offset_guard=True),
    Profile(name="time250", tracking="time", tracking_value=0.008, blend_s=0.004, throttle=1, offset_guard=True),
    Profile(name="legacy-stop", tracking="time", tracking_value=2.0, blend="none", overlay="stop-point", throttle=1,
            sim_only=True),
)  # fmt: skip

PROFILES: dict[str, Profile] = {profile.name: profile for profile in _ALL}
"""The named profiles; ``speed125`` is the default and safe for any first offset."""
