"""Motions made of other motions: seen in a mirror, or played faster or slower."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from station.errors import UsageError
from station.protocols import Motion, Reference

SLOWEST, FASTEST = 0.1, 10.0
"""What `retimed` takes."""

_FLIP = np.array([1.0, -1.0, 1.0])  # the mirror is the plane of x and z
_FLIP_TURN = np.array([-1.0, 1.0, -1.0])
_FLIP_QUAT = np.array([1.0, -1.0, 1.0, -1.0])
_SIDES = {"left": "right", "right": "left"}


class Mirrored:
    """A motion in which left and right are exchanged (`station.protocols.Motion`).

    The mirror is the plane through the x and z axes of the motion's world.

    Args:
        motion: What is mirrored; every joint of one side has its like on the other.
    """

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        names = motion.joint_names
        self._columns = np.array([names.index(_other_side(name)) for name in names], dtype=np.intp)
        self._signs = np.array([-1.0 if name.endswith(("_roll", "_yaw")) else 1.0 for name in names])

    @property
    def name(self) -> str:
        """Name of the motion, with what was done to it."""
        return f"{self._motion.name}#mirror"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Those of the motion, in its order."""
        return self._motion.joint_names

    @property
    def duration_s(self) -> float:
        """That of the motion [s]."""
        return self._motion.duration_s

    @property
    def fps(self) -> float:
        """That of the motion [Hz]."""
        return self._motion.fps

    def at(self, time_s: float) -> Reference:
        """Return the mirrored reference at a time [s]."""
        seen = self._motion.at(time_s)
        return Reference(
            root_pos=seen.root_pos * _FLIP,
            root_quat_wxyz=seen.root_quat_wxyz * _FLIP_QUAT,
            root_lin_vel=seen.root_lin_vel * _FLIP,
            root_ang_vel=seen.root_ang_vel * _FLIP_TURN,
            q=seen.q[self._columns] * self._signs,
        )

    def facts(self) -> dict[str, Any]:
        """Return those of the motion, and whether this is its mirror image."""
        facts = self._motion.facts()
        return {**facts, "mirrored": not facts.get("mirrored", False)}


class Retimed:
    """A motion played faster or slower (`station.protocols.Motion`).

    Args:
        motion: What is played.
        speed: How much faster; 0.5 takes twice as long.

    Raises:
        UsageError: a speed below `SLOWEST` or above `FASTEST`.
    """

    def __init__(self, motion: Motion, speed: float) -> None:
        if not SLOWEST <= speed <= FASTEST:
            raise UsageError(f"{motion.name}: speed is {speed}; expected a number from {SLOWEST:g} to {FASTEST:g}")
        self._motion, self._speed = motion, float(speed)

    @property
    def name(self) -> str:
        """Name of the motion, with what was done to it."""
        return f"{self._motion.name}#speed={self._speed:g}"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Those of the motion."""
        return self._motion.joint_names

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last at the new speed [s]."""
        return self._motion.duration_s / self._speed

    @property
    def fps(self) -> float:
        """Recorded frames per second at the new speed [Hz]."""
        return self._motion.fps * self._speed

    def at(self, time_s: float) -> Reference:
        """Return the reference at a time [s] of the new speed, its velocities faster by as much."""
        seen = self._motion.at(time_s * self._speed)
        return replace(seen, root_lin_vel=seen.root_lin_vel * self._speed, root_ang_vel=seen.root_ang_vel * self._speed)

    def facts(self) -> dict[str, Any]:
        """Return those of the motion, with its times at the new speed."""
        facts = self._motion.facts()
        changed = {**facts, "duration_s": self.duration_s, "speed": self._speed * facts.get("speed", 1.0)}
        if "clips" in facts:
            times = ("start_s", "end_s")
            changed["clips"] = [
                {key: value / self._speed if key in times else value for key, value in part.items()}
                for part in facts["clips"]
            ]
        return changed


def mirrored(motion: Motion) -> Mirrored:
    """Return a motion seen in a mirror: left becomes right."""
    return Mirrored(motion)


def retimed(motion: Motion, speed: float) -> Retimed:
    """Return a motion played faster (above 1) or slower."""
    return Retimed(motion, speed)


def _other_side(joint: str) -> str:
    side, _, rest = joint.partition("_")
    return f"{_SIDES[side]}_{rest}" if side in _SIDES else joint
