"""The 29 joints of the Unitree G1: axis, range, effort, speed and armature, in Unitree's motor order 0-28.

Source: ``g1_29dof_rev_1_0`` of unitree_rl_gym (ranges, efforts, speeds; the same ranges stand in TWIST2's
``g1_sim2sim_29dof.xml``); armatures are the rotor inertias of the four motor types, as in mjlab's constants. Which of
the joints TWIST and TWIST2 have, and in which order, is checked against their models.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from adapters.robots.legged.table import Joint, mirrored

if TYPE_CHECKING:  # NumPy is loaded where arrays are made: names are asked for where that would take too long
    from station.protocols import Floats

# Rotor inertia seen at the joint [kg m^2]; ankles, waist roll and waist pitch are driven by two 5020 each.
_MOTOR_5020 = 0.003609725
_MOTOR_7520_14 = 0.01017752
_MOTOR_7520_22 = 0.025101925
_MOTOR_4010 = 0.00425

JOINTS: tuple[Joint, ...] = (
    Joint("left_hip_pitch", "y", -2.5307, 2.8798, 88.0, 32.0, _MOTOR_7520_14),
    Joint("left_hip_roll", "x", -0.5236, 2.9671, 139.0, 20.0, _MOTOR_7520_22),
    Joint("left_hip_yaw", "z", -2.7576, 2.7576, 88.0, 32.0, _MOTOR_7520_14),
    Joint("left_knee", "y", -0.087267, 2.8798, 139.0, 20.0, _MOTOR_7520_22),
    Joint("left_ankle_pitch", "y", -0.87267, 0.5236, 50.0, 37.0, 2 * _MOTOR_5020),
    Joint("left_ankle_roll", "x", -0.2618, 0.2618, 50.0, 37.0, 2 * _MOTOR_5020),
    Joint("right_hip_pitch", "y", -2.5307, 2.8798, 88.0, 32.0, _MOTOR_7520_14),
    Joint("right_hip_roll", "x", -2.9671, 0.5236, 139.0, 20.0, _MOTOR_7520_22),
    Joint("right_hip_yaw", "z", -2.7576, 2.7576, 88.0, 32.0, _MOTOR_7520_14),
    Joint("right_knee", "y", -0.087267, 2.8798, 139.0, 20.0, _MOTOR_7520_22),
    Joint("right_ankle_pitch", "y", -0.87267, 0.5236, 50.0, 37.0, 2 * _MOTOR_5020),
    Joint("right_ankle_roll", "x", -0.2618, 0.2618, 50.0, 37.0, 2 * _MOTOR_5020),
    Joint("waist_yaw", "z", -2.618, 2.618, 88.0, 32.0, _MOTOR_7520_14),
    Joint("waist_roll", "x", -0.52, 0.52, 50.0, 37.0, 2 * _MOTOR_5020),
    Joint("waist_pitch", "y", -0.52, 0.52, 50.0, 37.0, 2 * _MOTOR_5020),
    Joint("left_shoulder_pitch", "y", -3.0892, 2.6704, 25.0, 37.0, _MOTOR_5020),
    Joint("left_shoulder_roll", "x", -1.5882, 2.2515, 25.0, 37.0, _MOTOR_5020),
    Joint("left_shoulder_yaw", "z", -2.618, 2.618, 25.0, 37.0, _MOTOR_5020),
    Joint("left_elbow", "y", -1.0472, 2.0944, 25.0, 37.0, _MOTOR_5020),
    Joint("left_wrist_roll", "x", -1.97222, 1.97222, 25.0, 37.0, _MOTOR_5020),
    Joint("left_wrist_pitch", "y", -1.61443, 1.61443, 5.0, 22.0, _MOTOR_4010),
    Joint("left_wrist_yaw", "z", -1.61443, 1.61443, 5.0, 22.0, _MOTOR_4010),
    Joint("right_shoulder_pitch", "y", -3.0892, 2.6704, 25.0, 37.0, _MOTOR_5020),
    Joint("right_shoulder_roll", "x", -2.2515, 1.5882, 25.0, 37.0, _MOTOR_5020),
    Joint("right_shoulder_yaw", "z", -2.618, 2.618, 25.0, 37.0, _MOTOR_5020),
    Joint("right_elbow", "y", -1.0472, 2.0944, 25.0, 37.0, _MOTOR_5020),
    Joint("right_wrist_roll", "x", -1.97222, 1.97222, 25.0, 37.0, _MOTOR_5020),
    Joint("right_wrist_pitch", "y", -1.61443, 1.61443, 5.0, 22.0, _MOTOR_4010),
    Joint("right_wrist_yaw", "z", -1.61443, 1.61443, 5.0, 22.0, _MOTOR_4010),
)
"""Every joint, in Unitree's motor order 0-28."""

G1_29 = tuple(joint.name for joint in JOINTS)
"""Their names; TWIST2's joints."""

TO_ISAAC = [0, 6, 12, 1, 7, 13, 2, 8, 14, 3, 9, 15, 22, 4, 10, 16, 23, 5, 11, 17, 24, 18, 25, 19, 26, 20, 27, 21, 28]
FROM_ISAAC = sorted(range(len(TO_ISAAC)), key=TO_ISAAC.__getitem__)
"""Indices into the one order, in the other: ``q[TO_ISAAC]`` is in Isaac Lab's, level by level from the base on."""

LEGS = G1_29[:12]
WAIST = G1_29[12:15]

_WRIST = ("wrist_roll", "wrist_pitch", "wrist_yaw")
G1_23 = tuple(name for name in G1_29 if not name.endswith(_WRIST))
"""Joints of TWIST's policy: no wrists."""

G1_25 = tuple(name for name in G1_29 if not name.endswith(_WRIST[1:]))
"""Joints of TWIST's command: each arm with its wrist roll."""

# No source gives a rotor inertia of a hand's motors: this one is ours, well above a finger's own inertia.
_FINGER = 0.001

DEX3_LEFT: tuple[Joint, ...] = (
    Joint("left_hand_thumb_0", "y", -1.0472, 1.0472, 2.45, 3.14, _FINGER),
    Joint("left_hand_thumb_1", "z", -0.724312, 1.0472, 1.4, 12.0, _FINGER),
    Joint("left_hand_thumb_2", "z", 0.0, 1.74533, 1.4, 12.0, _FINGER),
    Joint("left_hand_middle_0", "z", -1.5708, 0.0, 1.4, 12.0, _FINGER),
    Joint("left_hand_middle_1", "z", -1.74533, 0.0, 1.4, 12.0, _FINGER),
    Joint("left_hand_index_0", "z", -1.5708, 0.0, 1.4, 12.0, _FINGER),
    Joint("left_hand_index_1", "z", -1.74533, 0.0, 1.4, 12.0, _FINGER),
)
"""Of a Dex3-1 hand, in the order of its MJCF. Source: ``dex3_1_l`` of unitreerobotics/unitree_ros."""

DEX3_RIGHT: tuple[Joint, ...] = tuple(mirrored(DEX3_LEFT))

HAND_LEFT = ("thumb_0", "thumb_1", "thumb_2", "middle_0", "middle_1", "index_0", "index_1")
HAND_RIGHT = ("thumb_0", "thumb_1", "thumb_2", "index_0", "index_1", "middle_0", "middle_1")
"""Dex3-1 joints in the order of TWIST2's hand driver; the two sides differ."""

_BY_NAME = {joint.name: joint for joint in (*JOINTS, *DEX3_LEFT, *DEX3_RIGHT)}


def hand(side: str) -> tuple[str, ...]:
    """Return the seven joints of one Dex3-1 hand, ``left`` or ``right``, side included in the names."""
    return tuple(f"{side}_hand_{name}" for name in (HAND_LEFT if side == "left" else HAND_RIGHT))


def select(names: tuple[str, ...]) -> tuple[Joint, ...]:
    """Return the joints of these names, in their order."""
    return tuple(_BY_NAME[name] for name in names)


def lower(names: tuple[str, ...]) -> Floats:
    """Return the lower ends of the ranges of these joints [rad]."""
    return _column("lower", names)


def upper(names: tuple[str, ...]) -> Floats:
    """Return the upper ends of the ranges of these joints [rad]."""
    return _column("upper", names)


def velocity(names: tuple[str, ...]) -> Floats:
    """Return the greatest speeds of these joints [rad/s]."""
    return _column("velocity_rad_s", names)


def _column(field: str, names: tuple[str, ...]) -> Floats:
    import numpy as np

    return np.array([getattr(joint, field) for joint in select(names)])
