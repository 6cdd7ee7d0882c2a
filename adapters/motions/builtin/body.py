"""From what the pelvis, the feet and the upper body do to a motion of all joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from adapters.commands.twist2 import FORMAT as COMMAND
from adapters.motions.builtin import legs
from adapters.motions.builtin.profiles import FPS
from adapters.motions.raw import RawMotion
from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import ConfigError
from station.protocols import Floats

FORMAT = "builtin"
STANDING_Q = np.array(COMMAND.default[6:])
"""The pose that every motion begins and ends in: that in which the policy stands, shape (29,) [rad]."""

RANGE_MARGIN = 0.02
"""Part of a joint's range that is left free at either end."""

_FREE = RANGE_MARGIN * (g1.upper(G1_29) - g1.lower(G1_29))
_LOWEST, _HIGHEST = g1.lower(G1_29) + _FREE, g1.upper(G1_29) - _FREE
_ANKLES = [kinematics.INDEX[f"{side}_ankle_roll"] for side in legs.SIDES]
_SOLE_DEPTH_M = float(-kinematics.SOLE_POINTS[0, 2])
_STANDING = kinematics.forward(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), STANDING_Q[None])

STANDING_HEIGHT_M = float(_SOLE_DEPTH_M - _STANDING.position[_ANKLES[0], 0, 2])
"""Height of the pelvis above the floor when standing; the legs' own, not the command's rounded default."""

STANDING_FEET = _STANDING.position[_ANKLES, 0] + (0.0, 0.0, STANDING_HEIGHT_M)
"""Where the two ankle_roll links are when standing with the pelvis above the origin, shape (2, 3) [m]."""

STANDING_COM = _STANDING.centre_of_mass()[0] + (0.0, 0.0, STANDING_HEIGHT_M)
"""Centre of mass when standing with the pelvis above the origin [m]."""

_FOLLOWS = 0.87  # of a shift of the pelvis, how much the centre of mass makes: the feet stay
_BALANCED_M = 2e-4
_ROUNDS = 10


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """What is asked of the whole body, frame by frame.

    Attributes:
        pelvis: Position of the pelvis, shape (n, 3) [m].
        pelvis_quat: Its orientation, unit quaternions wxyz, shape (n, 4).
        feet: Positions of the two ankle_roll links, shape (2, n, 3) [m].
        feet_yaw: Their headings, shape (2, n) [rad]; soles stay level.
        upper: Waist and arms, the last 17 of `adapters.robots.g1.joints.G1_29`, shape (n, 17) [rad].
    """

    pelvis: Floats
    pelvis_quat: Floats
    feet: Floats
    feet_yaw: Floats
    upper: Floats

    def joints(self, guess: Floats | None = None) -> Floats:
        """Return all joints, shape (n, 29) [rad], searched from a guess of the same shape.

        Raises:
            ConfigError: a foot is out of reach.
        """
        leg_q = legs.solve(
            self.pelvis,
            kinematics.matrix(self.pelvis_quat),
            self.feet,
            kinematics.about("z", self.feet_yaw),
            guess=None if guess is None else guess[:, : len(legs.STANDING_LEGS)],
        )
        return np.concatenate([leg_q, self.upper], axis=1)

    def balanced(self, com_xy: Floats) -> tuple[Pose, Floats]:
        """Shift the pelvis so that the whole body's centre of mass is above given points, shape (n, 2) [m].

        Returns:
            The pose, and its joints, shape (n, 29) [rad].

        Raises:
            ConfigError: a foot is out of reach, or the weight cannot be there.
        """
        pose, q = self, self.joints()
        for _ in range(_ROUNDS):
            com = kinematics.forward(pose.pelvis, pose.pelvis_quat, q).centre_of_mass()
            missing = com_xy - com[:, :2]
            if np.abs(missing).max() < _BALANCED_M:
                return pose, q
            pelvis = pose.pelvis.copy()
            pelvis[:, :2] += missing / _FOLLOWS
            pose = replace(pose, pelvis=pelvis)
            q = pose.joints(q)
        raise ConfigError(f"no pelvis puts the weight within {np.abs(missing).max():.3f} m of its place; shift it less")

    def motion(self, name: str, q: Floats) -> RawMotion:
        """Return the frames, with their joints, as a motion of this name."""
        return RawMotion(Path(name), FORMAT, FPS, self.pelvis, self.pelvis_quat, q)


def first_beyond_range(q: Floats) -> str | None:
    """Return the first joint of q, shape (n, 29) [rad], that comes nearer to an end of its range than allowed."""
    beyond = ((q < _LOWEST) | (q > _HIGHEST)).any(axis=0)
    return G1_29[int(beyond.argmax())] if beyond.any() else None


def standing_feet(frames: int) -> tuple[Floats, Floats]:
    """Return positions and headings of two feet that stay where they stand."""
    return np.repeat(STANDING_FEET[:, None], frames, axis=1), np.zeros((2, frames))


def from_roll_pitch_yaw(angles: Floats) -> Floats:
    """Return quaternions of ZYX Euler angles roll, pitch, yaw [rad], shape (n, 4)."""
    roll, pitch, yaw = (rotations.from_rotation_vector(angles[:, [axis]] * np.eye(3)[axis]) for axis in range(3))
    return rotations.multiply(yaw, rotations.multiply(pitch, roll))


def turned(vectors: Floats, angle: Floats | float) -> Floats:
    """Turn vectors of the plane, shape (..., 2), to the left by angles [rad], shape (...)."""
    x, y = vectors[..., 0], vectors[..., 1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return rotations.joined(x * cosine - y * sine, x * sine + y * cosine)
