"""The heading of a reference whose commands have none: the sum of their yaw rates, near to where the robot looks."""

from __future__ import annotations

import numpy as np

from station.protocols import Floats

Angle = Floats | float

MOST_AHEAD_RAD = 0.6
"""How far a reference may look beside the robot [rad]: one that was pushed or carried round goes on from where it
looks, and does not turn back as fast as it can. In the dance of Holosoma's files it is 0.3 at most."""


def rate(roll: Angle, pitch: Angle, pitching: Angle, yaw_rate: Angle) -> Floats:
    """Return how fast a heading changes [rad/s], arguments and result of one shape.

    Args:
        roll, pitch: Of the root [rad].
        pitching: Change of the pitch [rad/s].
        yaw_rate: About the root's own axis, which leans [rad/s].
    """
    return np.asarray((yaw_rate + pitching * np.sin(roll)) / (np.cos(pitch) * np.cos(roll)))


def within_reach(heading: float, looks: float) -> float:
    """Return a heading, or the nearest that is within reach of where the robot looks; as a recording has it [rad]."""
    ahead = min(max(_wrapped(heading - looks), -MOST_AHEAD_RAD), MOST_AHEAD_RAD)
    return float(np.float32(_wrapped(looks + ahead)))


def _wrapped(angle: float) -> float:
    return float(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
