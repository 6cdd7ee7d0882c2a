"""Where the legs must bend so that the feet are where they shall be: inverse kinematics for all frames at once."""

from __future__ import annotations

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import LEGS
from station.errors import ConfigError
from station.protocols import Floats

SIDES = ("left", "right")
"""Order of the two feet in every array of this package."""

STANDING_LEGS = np.array(FORMAT.default[6:18])
"""Joints of both legs when standing, in the order of `adapters.robots.g1.joints.LEGS` [rad]."""

_CHAIN = [kinematics.LINKS[kinematics.INDEX[name]] for name in LEGS[:6]]
_MIRROR = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])  # the right leg is the left one mirrored, to 0.1 mm
_FIXED, _BY_SINE, _BY_COSINE = kinematics.turns(_CHAIN)
_PLACES = np.array([link.position for link in _CHAIN]) * _MIRROR[:, None, None]  # (2, 1, 6, 3), in the parent's frame
_AXES = ["xyz".index(link.axis) for link in _CHAIN]
_EYE = np.eye(6)
_ROUNDS = 12
_CLOSE = 1e-6  # m and rad
_HIP = np.array(_CHAIN[0].position) + _CHAIN[1].position  # where a leg hangs in the pelvis' frame: its roll axis


def highest(turned: Floats, hips_xy: Floats, feet: Floats, knee: float) -> Floats:
    """Return how high the pelvis may be so that no knee is straighter than an angle [rad], shape (n,) [m].

    Args:
        turned: Rotation matrices of the pelvis, shape (n, 3, 3).
        hips_xy: Its position in the plane, shape (n, 2) [m].
        feet: Positions of the ankle_roll links, shape (2, n, 3) [m].
        knee: The angle [rad].
    """
    stretched = np.zeros((2, 1, 6))
    stretched[..., LEGS.index("left_knee")] = knee
    length = float(np.linalg.norm(_forward(stretched)[0][0, 0] - _HIP))
    hangs = (turned @ (_HIP * _MIRROR)[:, None, :, None])[..., 0]
    across = np.square(feet[..., :2] - hips_xy - hangs[..., :2]).sum(axis=-1)
    return np.asarray((feet[..., 2] + np.sqrt(np.maximum(length**2 - across, 0.0)) - hangs[..., 2]).min(axis=0))


def solve(hips: Floats, turned: Floats, feet: Floats, feet_turned: Floats, *, guess: Floats | None = None) -> Floats:
    """Return the leg joints, shape (n, 12), in the order of `adapters.robots.g1.joints.LEGS` [rad].

    Args:
        hips: Positions of the pelvis, shape (n, 3) [m].
        turned: Rotation matrices of the pelvis, shape (n, 3, 3).
        feet: Positions of the ankle_roll links, shape (2, n, 3) [m], left first.
        feet_turned: Their rotation matrices, shape (2, n, 3, 3).
        guess: Joints to begin the search with, shape (n, 12); standing when None.

    Raises:
        ConfigError: a foot is out of a leg's reach.
    """
    inverse = turned.swapaxes(-1, -2)
    target = (inverse @ (feet - hips)[..., None])[..., 0]
    target_turned = inverse @ feet_turned
    start = np.tile(STANDING_LEGS, (target.shape[1], 1)) if guess is None else guess
    q = np.stack(np.split(start, 2, axis=1))
    for _ in range(_ROUNDS):
        position, rotation, jacobian = _forward(q)
        twist = rotation.swapaxes(-1, -2) @ target_turned
        turn = 0.5 * np.stack(
            [twist[..., 2, 1] - twist[..., 1, 2], twist[..., 0, 2] - twist[..., 2, 0],
             twist[..., 1, 0] - twist[..., 0, 1]], axis=-1,
        )  # fmt: skip
        error = np.concatenate([target - position, (rotation @ turn[..., None])[..., 0]], axis=-1)
        if np.abs(error).max() < _CLOSE:
            return np.concatenate(list(q), axis=-1)
        # A little damping keeps a nearly straight leg from swinging through; it dies out with the error, almost.
        damping = (1e-9 + 1e-3 * np.minimum(np.square(error).sum(axis=-1), 1.0))[..., None, None] * _EYE
        normal = jacobian.swapaxes(-1, -2) @ jacobian + damping
        step = np.linalg.solve(normal, jacobian.swapaxes(-1, -2) @ error[..., None])[..., 0]
        q += np.clip(step, -0.5, 0.5)
    side, frame, _ = np.unravel_index(int(np.abs(error).argmax()), error.shape)
    raise ConfigError(
        f"frame {frame}: the {SIDES[int(side)]} foot is out of the leg's reach by {np.abs(error).max():.3f} m or rad; "
        "take shorter steps or a lower pelvis"
    )


def _forward(q: Floats) -> tuple[Floats, Floats, Floats]:
    """Poses of the feet in the pelvis' frame, (2, n, 3) and (2, n, 3, 3), and how joints move them, (2, n, 6, 6)."""
    poses = np.empty((*q.shape, 3, 4))  # rotation and position of each link in its parent's frame, then in the pelvis'
    poses[..., :3] = _FIXED + np.sin(q)[..., None, None] * _BY_SINE + np.cos(q)[..., None, None] * _BY_COSINE
    poses[..., 3] = _PLACES
    for index in range(1, len(_CHAIN)):
        parent = poses[:, :, index - 1]
        poses[:, :, index] = parent[..., :3] @ poses[:, :, index]
        poses[:, :, index, :, 3] += parent[..., 3]
    position = poses[:, :, -1, :, 3]
    turning = poses[:, :, range(len(_CHAIN)), :, _AXES].transpose(1, 2, 3, 0)
    moving = _cross(turning, position[..., None] - poses[..., 3].swapaxes(-1, -2))
    return position, poses[:, :, -1, :, :3], np.concatenate([moving, turning], axis=-2)


def _cross(left: Floats, right: Floats) -> Floats:
    """Vector products of the columns of two arrays (..., 3, k); numpy's own costs five times as much on few columns."""
    a, b = left[..., (1, 2, 0), :], left[..., (2, 0, 1), :]
    return np.asarray(a * right[..., (2, 0, 1), :] - b * right[..., (1, 2, 0), :])
