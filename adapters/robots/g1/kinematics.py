"""Where the links of a G1 are: forward kinematics and centre of mass in numpy, for many frames at once.

Small enough to make and check motions without a physics engine. Source of the numbers: ``g1_29dof_rev_1_0`` of
unitree_rl_gym (BSD-3-Clause); `tests/adapters/robots/g1/test_kinematics.py` compares them with MuJoCo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from station import rotations
from station.protocols import Floats

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Link:
    """One link; every link but the pelvis turns about a joint at its own origin.

    Attributes:
        name: Name in Unitree's MJCF, without ``_link``.
        parent: Name of the link that carries it.
        position: Of its origin, in the parent's frame [m].
        quat_wxyz: Of its frame at joint position zero, in the parent's frame; to six digits.
        mass_kg: Mass [kg].
        com: Centre of mass, in its own frame [m].
        axis: Axis of its joint, in its own frame; "" for the pelvis.
    """

    name: str
    parent: str
    position: Vector
    quat_wxyz: tuple[float, float, float, float]
    mass_kg: float
    com: Vector
    axis: Literal["x", "y", "z", ""]


LINKS: tuple[Link, ...] = (
    Link("pelvis", "world", (0.0, 0.0, 0.793), (1.0, 0.0, 0.0, 0.0), 3.813, (0.0, 0.0, -0.07605), ""),
    Link("left_hip_pitch", "pelvis", (0.0, 0.064452, -0.1027), (1.0, 0.0, 0.0, 0.0),
         1.35, (0.002741, 0.047791, -0.02606), "y"),
    Link("left_hip_roll", "left_hip_pitch", (0.0, 0.052, -0.030465), (0.996179, 0.0, -0.0873386, 0.0),
         1.52, (0.029812, -0.001045, -0.087934), "x"),
    Link("left_hip_yaw", "left_hip_roll", (0.025001, 0.0, -0.12412), (1.0, 0.0, 0.0, 0.0),
         1.702, (-0.057709, -0.010981, -0.15078), "z"),
    Link("left_knee", "left_hip_yaw", (-0.078273, 0.0021489, -0.17734), (0.996179, 0.0, 0.0873386, 0.0),
         1.932, (0.005457, 0.003964, -0.12074), "y"),
    Link("left_ankle_pitch", "left_knee", (0.0, -9.4445e-5, -0.30001), (1.0, 0.0, 0.0, 0.0),
         0.074, (-0.007269, 0.0, 0.011137), "y"),
    Link("left_ankle_roll", "left_ankle_pitch", (0.0, 0.0, -0.017558), (1.0, 0.0, 0.0, 0.0),
         0.608, (0.026505, 0.0, -0.016425), "x"),
    Link("right_hip_pitch", "pelvis", (0.0, -0.064452, -0.1027), (1.0, 0.0, 0.0, 0.0),
         1.35, (0.002741, -0.047791, -0.02606), "y"),
    Link("right_hip_roll", "right_hip_pitch", (0.0, -0.052, -0.030465), (0.996179, 0.0, -0.0873386, 0.0),
         1.52, (0.029812, 0.001045, -0.087934), "x"),
    Link("right_hip_yaw", "right_hip_roll", (0.025001, 0.0, -0.12412), (1.0, 0.0, 0.0, 0.0),
         1.702, (-0.057709, 0.010981, -0.15078), "z"),
    Link("right_knee", "right_hip_yaw", (-0.078273, -0.0021489, -0.17734), (0.996179, 0.0, 0.0873386, 0.0),
         1.932, (0.005457, -0.003964, -0.12074), "y"),
    Link("right_ankle_pitch", "right_knee", (0.0, 9.4445e-5, -0.30001), (1.0, 0.0, 0.0, 0.0),
         0.074, (-0.007269, 0.0, 0.011137), "y"),
    Link("right_ankle_roll", "right_ankle_pitch", (0.0, 0.0, -0.017558), (1.0, 0.0, 0.0, 0.0),
         0.608, (0.026505, 0.0, -0.016425), "x"),
    Link("waist_yaw", "pelvis", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
         0.214, (0.003494, 0.000233, 0.018034), "z"),
    Link("waist_roll", "waist_yaw", (-0.0039635, 0.0, 0.044), (1.0, 0.0, 0.0, 0.0), 0.086, (0.0, 2.3e-5, 0.0), "x"),
    Link("torso", "waist_roll", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
         7.818, (0.00203158, 0.000339683, 0.184568), "y"),
    Link("left_shoulder_pitch", "torso", (0.0039563, 0.10022, 0.24778), (0.990264, 0.139201, 1.38722e-5, -9.86868e-5),
         0.718, (0.0, 0.035892, -0.011628), "y"),
    Link("left_shoulder_roll", "left_shoulder_pitch", (0.0, 0.038, -0.013831), (0.990268, -0.139172, 0.0, 0.0),
         0.643, (-0.000227, 0.00727, -0.063243), "x"),
    Link("left_shoulder_yaw", "left_shoulder_roll", (0.0, 0.00624, -0.1032), (1.0, 0.0, 0.0, 0.0),
         0.734, (0.010773, -0.002949, -0.072009), "z"),
    Link("left_elbow", "left_shoulder_yaw", (0.015783, 0.0, -0.080518), (1.0, 0.0, 0.0, 0.0),
         0.6, (0.064956, 0.004454, -0.010062), "y"),
    Link("left_wrist_roll", "left_elbow", (0.1, 0.00188791, -0.01), (1.0, 0.0, 0.0, 0.0),
         0.085445, (0.0171394, 0.000537591, 4.8864e-07), "x"),
    Link("left_wrist_pitch", "left_wrist_roll", (0.038, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
         0.48405, (0.0229999, -0.00111685, -0.00111658), "y"),
    Link("left_wrist_yaw", "left_wrist_pitch", (0.046, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
         0.254576, (0.0708244, 0.000191745, 0.00161742), "z"),
    Link("right_shoulder_pitch", "torso", (0.0039563, -0.10021, 0.24778), (0.990264, -0.139201, 1.38722e-5, 9.86868e-5),
         0.718, (0.0, -0.035892, -0.011628), "y"),
    Link("right_shoulder_roll", "right_shoulder_pitch", (0.0, -0.038, -0.013831), (0.990268, 0.139172, 0.0, 0.0),
         0.643, (-0.000227, -0.00727, -0.063243), "x"),
    Link("right_shoulder_yaw", "right_shoulder_roll", (0.0, -0.00624, -0.1032), (1.0, 0.0, 0.0, 0.0),
         0.734, (0.010773, 0.002949, -0.072009), "z"),
    Link("right_elbow", "right_shoulder_yaw", (0.015783, 0.0, -0.080518), (1.0, 0.0, 0.0, 0.0),
         0.6, (0.064956, -0.004454, -0.010062), "y"),
    Link("right_wrist_roll", "right_elbow", (0.1, -0.00188791, -0.01), (1.0, 0.0, 0.0, 0.0),
         0.085445, (0.0171394, -0.000537591, 4.8864e-07), "x"),
    Link("right_wrist_pitch", "right_wrist_roll", (0.038, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
         0.48405, (0.0229999, 0.00111685, -0.00111658), "y"),
    Link("right_wrist_yaw", "right_wrist_pitch", (0.046, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
         0.254576, (0.0708244, -0.000191745, 0.00161742), "z"),
)  # fmt: skip
"""Every link, parents first: the pelvis, then the link that each joint of `adapters.robots.g1.joints.G1_29` turns."""

INDEX = {link.name: index for index, link in enumerate(LINKS)}
"""Place of a link in `LINKS`, and in what `forward` returns."""

TOTAL_MASS_KG = sum(link.mass_kg for link in LINKS)

SOLE_POINTS = np.array([(-0.05, 0.025, -0.035), (-0.05, -0.025, -0.035), (0.12, 0.03, -0.035), (0.12, -0.03, -0.035)])
"""Lowest points of a foot's four contact spheres, in the frame of its ankle_roll link, shape (4, 3) [m]."""

_PARENT = [INDEX.get(link.parent, -1) for link in LINKS]
_POSITION = np.array([link.position for link in LINKS])
_MASS = np.array([link.mass_kg for link in LINKS])
_COM = np.array([link.com for link in LINKS])


@dataclass(frozen=True, slots=True, eq=False)
class LinkPoses:
    """Where every link is, in the world of the root's pose.

    Attributes:
        position: Origins, shape (links, n, 3) [m].
        rotation: Rotation matrices from link to world, shape (links, n, 3, 3).
    """

    position: Floats
    rotation: Floats

    def points(self, link: str, points: Floats) -> Floats:
        """Transform points (k, 3) of a link's frame into the world, shape (n, k, 3) [m]."""
        index = INDEX[link]
        return np.asarray(self.position[index][:, None] + points @ self.rotation[index].swapaxes(-1, -2))

    def centre_of_mass(self) -> Floats:
        """Return the centre of mass of the whole robot, shape (n, 3) [m]."""
        centres = self.position + (self.rotation @ _COM[:, None, :, None])[..., 0]
        return np.asarray(np.tensordot(_MASS, centres, axes=1) / TOTAL_MASS_KG)


def forward(root_pos: Floats, root_quat_wxyz: Floats, q: Floats) -> LinkPoses:
    """Return the pose of every link.

    Args:
        root_pos: Positions of the pelvis, shape (n, 3) [m].
        root_quat_wxyz: Its orientations, unit quaternions, shape (n, 4).
        q: Joint positions in the order of `adapters.robots.g1.joints.G1_29`, shape (n, 29) [rad].
    """
    position = np.empty((len(LINKS), len(q), 3))
    rotation = np.empty((len(LINKS), len(q), 3, 3))
    position[0], rotation[0] = root_pos, matrix(root_quat_wxyz)
    turned = _FIXED + np.sin(q)[..., None, None] * _BY_SINE + np.cos(q)[..., None, None] * _BY_COSINE
    for index in range(1, len(LINKS)):
        parent = rotation[_PARENT[index]]
        position[index] = position[_PARENT[index]] + parent @ _POSITION[index]
        rotation[index] = parent @ turned[:, index - 1]
    return LinkPoses(position, rotation)


def soles(root_quat_wxyz: Floats, q_legs: Floats) -> Floats:
    """Return the lowest points of both feet from the root, in the world of its orientation, shape (8, 3) [m].

    As `forward` does of one frame, both legs at once: in half of the time, for what comes a hundred times a second.

    Args:
        root_quat_wxyz: Orientation of the pelvis, a unit quaternion, shape (4,).
        q_legs: The first joint positions in the order of `adapters.robots.g1.joints.G1_29`, shape (12,) [rad].
    """
    q = q_legs.reshape(2, 6, 1, 1)
    turned = _LEGS[0] + np.sin(q) * _LEGS[1] + np.cos(q) * _LEGS[2]
    position, rotation = _LEGS_AT[:, 0], turned[:, 0]
    for index in range(1, 6):
        position = position + (rotation @ _LEGS_AT[:, index, :, None])[..., 0]
        rotation = rotation @ turned[:, index]
    points = position[:, None] + SOLE_POINTS @ rotation.swapaxes(-1, -2)
    return np.asarray(points.reshape(-1, 3) @ matrix(root_quat_wxyz).T)


def matrix(quat_wxyz: Floats) -> Floats:
    """Return the rotation matrices of unit quaternions, shape (..., 3, 3)."""
    columns = [rotations.rotate(quat_wxyz, axis) for axis in np.eye(3)]
    return np.stack(columns, axis=-1)


def about(axis: str, angle: Floats) -> Floats:
    """Return the matrices that turn about an axis by angles [rad], shape (..., 3, 3)."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turned = np.zeros((*np.shape(angle), 3, 3))
    cosine, sine = np.cos(angle), np.sin(angle)
    turned[..., 3 - first - second, 3 - first - second] = 1.0
    turned[..., first, first] = turned[..., second, second] = cosine
    turned[..., first, second], turned[..., second, first] = -sine, sine
    return turned


def turns(links: Sequence[Link]) -> tuple[Floats, Floats, Floats]:
    """Return what a link's rotation in its parent's frame is made of: the part that its joint does not change, and
    what the sine and the cosine of its joint's angle are multiplied by; each of shape (links, 3, 3)."""
    at_zero = matrix(rotations.normalized([link.quat_wxyz for link in links]))
    axes = np.array([[link.axis == axis for axis in "xyz"] for link in links], dtype=np.float64)
    along = axes[:, :, None] * axes[:, None, :]
    return at_zero @ along, at_zero @ np.cross(axes[:, None], -np.eye(3)), at_zero @ (np.eye(3) - along)


_FIXED, _BY_SINE, _BY_COSINE = turns(LINKS[1:])
_LEGS = [each.reshape(2, 6, 3, 3) for each in turns(LINKS[1:13])]
_LEGS_AT = _POSITION[1:13].reshape(2, 6, 3)
