"""Unitree's robots on legs, a row each. Joints stand limb after limb, as in their MJCF; `motors` gives the other order.

Ranges, efforts and speeds: the descriptions in unitreerobotics/unitree_rl_gym (Go2, H1, H1-2), in unitree_ros (G1 with
23 joints, speeds of the Go1) and in mujoco_menagerie (Go1). Motor indices: unitree_sdk2_python. Rotor inertias: of the
G1 as in `adapters.robots.g1.joints`; no source gives those of the others, theirs are what policies are known to walk
with. Gains of the stand are ours, for a simulation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import twist_keys
from adapters.robots.legged.table import Axis, Joint, LeggedRobot, mirrored

_Number = TypeVar("_Number")


def _alike(count: int, legs: tuple[float, ...]) -> tuple[float, ...]:
    """Return the numbers of one leg for each of several."""
    return legs * count


def _leg(corner: str, hip: tuple[float, float], thigh: tuple[float, float], calf: tuple[float, float],
         armature: float) -> tuple[Joint, ...]:  # fmt: skip
    """Return the joints of one leg of a Go1 or a Go2; their motors are the same."""
    return (
        Joint(f"{corner}_hip", "x", *hip, 23.7, 30.1, armature),
        Joint(f"{corner}_thigh", "y", *thigh, 23.7, 30.1, armature),
        Joint(f"{corner}_calf", "y", *calf, 35.55, 20.07, armature),
    )


_CORNERS = {"FL": "front left leg", "FR": "front right leg", "RL": "rear left leg", "RR": "rear right leg"}


def _of_corners(joints: tuple[Joint, ...]) -> dict[str, tuple[str, ...]]:
    return {
        _CORNERS[corner]: tuple(joint.name for joint in joints if joint.name.startswith(corner))
        for corner in dict.fromkeys(joint.name[:2] for joint in joints)
    }


# Genesis gives joints a rotor inertia of about 0.1, with which the one Go2 policy at hand was trained: with 0.05 to 0.2
# it walks, with 0.02 it falls.
_GO2_ARMATURE = 0.1
_GO2_THIGH = {"F": (-1.5708, 3.4907), "R": (-0.5236, 4.5379)}
_GO2_JOINTS = tuple(
    joint
    for corner in ("FL", "FR", "RL", "RR")
    for joint in _leg(corner, (-1.0472, 1.0472), _GO2_THIGH[corner[0]], (-2.7227, -0.83776), _GO2_ARMATURE)
)
_GO2_FRONT, _GO2_REAR = (0.0, 0.8, -1.5), (0.0, 1.0, -1.5)

GO2 = LeggedRobot(
    name="go2",
    model="unitree_go2",
    title="Unitree Go2",
    mjcf="builtin:go2.xml",
    joints=_GO2_JOINTS,
    motors=(3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8),
    groups=_of_corners(_GO2_JOINTS),
    root="base",
    feet=("_calf",),
    start_q=(*_GO2_FRONT, *_GO2_FRONT, *_GO2_REAR, *_GO2_REAR),
    start_height_m=0.335,
    stand_kp=_alike(4, (60.0, 60.0, 60.0)),
    stand_kd=_alike(4, (3.0, 3.0, 3.0)),
    least_height_m=0.1,
)

_GO1_JOINTS = tuple(
    joint
    for corner in ("FR", "FL", "RR", "RL")
    for joint in _leg(corner, (-0.863, 0.863), (-0.686, 4.501), (-2.818, -0.888), 0.005)
)

GO1 = LeggedRobot(
    name="go1",
    model="unitree_go1",
    title="Unitree Go1",
    mjcf="builtin:go1.xml",
    joints=_GO1_JOINTS,
    motors=tuple(range(12)),
    groups=_of_corners(_GO1_JOINTS),
    root="trunk",
    feet=("_calf",),
    start_q=_alike(2, (0.1, 0.9, -1.8, -0.1, 0.9, -1.8)),
    start_height_m=0.296,
    stand_kp=_alike(4, (60.0, 60.0, 60.0)),
    stand_kd=_alike(4, (2.0, 2.0, 2.0)),
    least_height_m=0.1,
)


def _limb(side: str, *rows: tuple[str, Axis, float, float, float, float]) -> tuple[Joint, ...]:
    """Return the joints of a limb of an H1 or an H1-2, whose rotor inertia is that of unitree_rl_gym's models."""
    return tuple(
        Joint(f"{side}{name}", axis, lower, upper, effort, speed, 0.01)
        for name, axis, lower, upper, effort, speed in rows
    )


def _humanoid(left_leg: tuple[Joint, ...], waist: tuple[Joint, ...], left_arm: tuple[Joint, ...]) -> tuple[Joint, ...]:
    return (*left_leg, *mirrored(left_leg), *waist, *left_arm, *mirrored(left_arm))


def _of_sides(joints: tuple[Joint, ...]) -> dict[str, tuple[str, ...]]:
    """Return the limbs of a humanoid: of a side, what begins at the hip is a leg."""
    groups: dict[str, tuple[str, ...]] = {}
    for joint in joints:
        side, _, rest = joint.name.partition("_")
        limb = f"{side} {'leg' if rest.startswith(('hip', 'knee', 'ankle')) else 'arm'}"
        name = limb if side in ("left", "right") else "waist"
        groups[name] = (*groups.get(name, ()), joint.name)
    return groups


_H1_JOINTS = _humanoid(
    _limb(
        "left_",
        ("hip_yaw", "z", -0.43, 0.43, 200, 23),
        ("hip_roll", "x", -0.43, 0.43, 200, 23),
        ("hip_pitch", "y", -1.57, 1.57, 200, 23),
        ("knee", "y", -0.26, 2.05, 300, 14),
        ("ankle", "y", -0.87, 0.52, 40, 9),
    ),
    _limb("", ("torso", "z", -2.35, 2.35, 200, 23)),
    _limb(
        "left_",
        ("shoulder_pitch", "y", -2.87, 2.87, 40, 9),
        ("shoulder_roll", "x", -0.34, 3.11, 40, 9),
        ("shoulder_yaw", "z", -1.3, 4.45, 18, 20),
        ("elbow", "y", -1.25, 2.61, 18, 20),
    ),
)

H1 = LeggedRobot(
    name="h1",
    model="unitree_h1",
    title="Unitree H1",
    mjcf="builtin:h1.xml",
    joints=_H1_JOINTS,
    motors=(7, 3, 4, 5, 10, 8, 0, 1, 2, 11, 6, 16, 17, 18, 19, 12, 13, 14, 15),
    groups=_of_sides(_H1_JOINTS),
    root="pelvis",
    feet=("ankle_link",),
    start_q=(*_alike(2, (0.0, 0.0, -0.1, 0.3, -0.2)), 0.0, *_alike(2, (0.0, 0.0, 0.0, 0.0))),
    start_height_m=1.036,
    stand_kp=(*_alike(2, (800.0, 800.0, 800.0, 1200.0, 1500.0)), 300.0, *_alike(2, (100.0, 100.0, 50.0, 50.0))),
    stand_kd=(*_alike(2, (14.0, 14.0, 14.0, 21.0, 10.0)), 6.0, *_alike(2, (2.0, 2.0, 2.0, 2.0))),
    least_height_m=0.5,
)

_H1_2_JOINTS = _humanoid(
    _limb(
        "left_",
        ("hip_yaw", "z", -0.43, 0.43, 200, 23),
        ("hip_pitch", "y", -3.14, 2.5, 200, 23),
        ("hip_roll", "x", -0.43, 3.14, 200, 23),
        ("knee", "y", -0.26, 2.05, 300, 14),
        ("ankle_pitch", "y", -0.897334, 0.523598, 60, 9),
        ("ankle_roll", "x", -0.261799, 0.261799, 40, 9),
    ),
    _limb("", ("torso", "z", -2.35, 2.35, 200, 23)),
    _limb(
        "left_",
        ("shoulder_pitch", "y", -3.14, 1.57, 40, 9),
        ("shoulder_roll", "x", -0.38, 3.4, 40, 9),
        ("shoulder_yaw", "z", -2.66, 3.01, 18, 20),
        ("elbow_pitch", "y", -0.95, 3.18, 18, 20),
        ("elbow_roll", "x", -3.01, 2.75, 19, 31.4),
        ("wrist_pitch", "y", -0.47, 0.47, 19, 31.4),
        ("wrist_yaw", "z", -1.27, 1.27, 19, 31.4),
    ),
)

H1_2 = LeggedRobot(
    name="h1_2",
    model="unitree_h1_2",
    title="Unitree H1-2",
    mjcf="builtin:h1_2.xml",
    joints=_H1_2_JOINTS,
    motors=tuple(range(27)),
    groups=_of_sides(_H1_2_JOINTS),
    root="pelvis",
    feet=("ankle_pitch_link", "ankle_roll_link"),
    start_q=(*_alike(2, (0.0, -0.16, 0.0, 0.36, -0.2, 0.0)), 0.0, *(0.0,) * 14),
    start_height_m=1.017,
    stand_kp=(
        *_alike(2, (600.0, 900.0, 900.0, 1200.0, 2000.0, 1000.0)), 300.0,
        *_alike(2, (120.0, 120.0, 120.0, 80.0, 80.0, 80.0, 80.0)),
    ),
    stand_kd=(
        *_alike(2, (12.0, 18.0, 18.0, 24.0, 10.0, 5.0)), 6.0,
        *_alike(2, (2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0)),
    ),
    least_height_m=0.5,
)  # fmt: skip


def _legs_of(robot: LeggedRobot, suffix: str) -> LeggedRobot:
    """Return a robot whose torso and arms are fixed at zero, as in the models of 10 and 12 joints of unitree_rl_gym."""
    places = [place for place, name in enumerate(robot.joint_names) if any(name in robot.groups[leg] for leg in _LEGS)]

    def of_legs(column: tuple[_Number, ...]) -> tuple[_Number, ...]:
        return tuple(column[place] for place in places)

    return replace(
        robot,
        name=f"{robot.name}_{suffix}",
        model=f"{robot.model}_{suffix}",
        title=f"{robot.title} with {suffix} joints",
        mjcf=f"builtin:{robot.name}_{suffix}.xml",
        joints=of_legs(robot.joints),
        motors=of_legs(robot.motors),
        groups={leg: robot.groups[leg] for leg in _LEGS},
        start_q=of_legs(robot.start_q),
        stand_kp=of_legs(robot.stand_kp),
        stand_kd=of_legs(robot.stand_kd),
    )


_LEGS = ("left leg", "right leg")
H1_10, H1_2_12 = _legs_of(H1, "10"), _legs_of(H1_2, "12")

_G1_LEG = (-0.1, 0.0, 0.0, 0.3, -0.2, 0.0)
_G1_LEG_KP, _G1_LEG_KD = (200.0, 200.0, 200.0, 300.0, 750.0, 375.0), (5.0, 5.0, 5.0, 6.0, 4.0, 3.0)
_G1_FEET = ("ankle_roll_link",)
_G1_12_JOINTS = g1.select(g1.LEGS)

G1_12 = LeggedRobot(
    name="g1_12",
    model="unitree_g1_12",
    title="Unitree G1 with 12 joints",
    mjcf="builtin:g1_12.xml",
    joints=_G1_12_JOINTS,
    motors=tuple(range(12)),
    groups=_of_sides(_G1_12_JOINTS),
    root="pelvis",
    feet=_G1_FEET,
    start_q=_alike(2, _G1_LEG),
    start_height_m=0.785,
    stand_kp=_alike(2, _G1_LEG_KP),
    stand_kd=_alike(2, _G1_LEG_KD),
    least_height_m=0.4,
    follows_motions=True,
)

# Unitree's own robot with 23 joints: one in the waist, five in each arm. The 23 of TWIST are others (`g1.G1_23`).
_G1_23_JOINTS = g1.select(
    tuple(
        name
        for name in g1.G1_29
        if name not in ("waist_roll", "waist_pitch") and not name.endswith(("wrist_pitch", "wrist_yaw"))
    )
)

G1_23 = LeggedRobot(
    name="g1_23",
    model="unitree_g1_23",
    title="Unitree G1 with 23 joints",
    mjcf="builtin:g1_23.xml",
    joints=_G1_23_JOINTS,
    motors=tuple(g1.G1_29.index(joint.name) for joint in _G1_23_JOINTS),
    groups=_of_sides(_G1_23_JOINTS),
    root="pelvis",
    feet=_G1_FEET,
    start_q=(*_alike(2, _G1_LEG), 0.0, 0.0, 0.2, 0.0, 1.2, 0.0, 0.0, -0.2, 0.0, 1.2, 0.0),
    start_height_m=0.785,
    stand_kp=(*_alike(2, _G1_LEG_KP), 200.0, *_alike(2, (60.0, 60.0, 40.0, 40.0, 20.0))),
    stand_kd=(*_alike(2, _G1_LEG_KD), 5.0, *_alike(2, (2.0, 2.0, 2.0, 2.0, 1.0))),
    least_height_m=0.4,
    follows_motions=True,
)

# Clip of the stock TWIST2 simulation [N m], by the end of the joint's name; the model's own `actuatorfrcrange` clips
# again after it. Source: facts of amazon-far/TWIST2, `server_low_level_g1_sim.py`.
_STOCK_CLIP_NM = {
    "hip_pitch": 100.0, "hip_roll": 100.0, "hip_yaw": 100.0, "knee": 150.0, "ankle_pitch": 40.0, "ankle_roll": 40.0,
    "waist_yaw": 150.0, "waist_roll": 150.0, "waist_pitch": 150.0,
    "shoulder_pitch": 40.0, "shoulder_roll": 40.0, "shoulder_yaw": 40.0, "elbow": 40.0,
    "wrist_roll": 4.0, "wrist_pitch": 4.0, "wrist_yaw": 4.0,
}  # fmt: skip
_STOCK_LEG = (-0.2, 0.0, 0.0, 0.4, -0.2, 0.0)

G1 = LeggedRobot(
    name=twist_keys.TWIST2_ROBOT,
    model="unitree_g1",
    title="Unitree G1",
    mjcf="builtin:g1.xml",
    joints=g1.JOINTS,
    motors=tuple(range(29)),
    groups=_of_sides(g1.JOINTS),
    root="pelvis",
    feet=_G1_FEET,
    # As in the stock simulation: the arms a little closer than in the policy's default.
    start_q=(*_alike(2, _STOCK_LEG), 0, 0, 0, 0, 0.2, 0, 1.2, 0, 0, 0, 0, -0.2, 0, 1.2, 0, 0, 0),
    start_height_m=0.793,
    stand_kp=(*_alike(2, _G1_LEG_KP), *(200.0,) * 3, *_alike(2, (60.0, 60.0, 40.0, 40.0, 20.0, 15.0, 15.0))),
    stand_kd=(*_alike(2, _G1_LEG_KD), *(5.0,) * 3, *_alike(2, (2.0, 2.0, 2.0, 2.0, 1.0, 0.5, 0.5))),
    clip_nm=tuple(_STOCK_CLIP_NM[name.removeprefix("left_").removeprefix("right_")] for name in g1.G1_29),
    fills_armature=False,  # the stock model has none at the wrists, and the station's G1 moves as there
)

_DEX3_JOINTS = (*g1.JOINTS[:22], *g1.DEX3_LEFT, *g1.JOINTS[22:], *g1.DEX3_RIGHT)
_DEX3_MOTORS = (*g1.G1_29, *g1.hand("left"), *g1.hand("right"))
_OPEN = (0.0, 0.1, 0.1, -0.1, -0.1, -0.1, -0.1)
"""A left hand at rest: a little closed, within the ends of its joints [rad]."""


def _with_hands(body: tuple[float, ...], left: tuple[float, ...], right: tuple[float, ...]) -> tuple[float, ...]:
    return (*body[:22], *left, *body[22:], *right)


# A G1 whose hands are joints as its others are: each a part with a command of its own, as legs and arms. Where hands
# are commanded beside the body, by TWIST2's keys, it is the G1 above.
G1_DEX3 = replace(
    G1,
    name="g1_dex3",
    model="unitree_g1_dex3",
    title="Unitree G1 with Dex3-1 hands",
    mjcf="builtin:g1_dex3.xml",
    joints=_DEX3_JOINTS,
    motors=tuple(_DEX3_MOTORS.index(joint.name) for joint in _DEX3_JOINTS),
    groups={
        **G1.groups,
        **{f"{side} hand": tuple(joint.name for joint in hand)
           for side, hand in (("left", g1.DEX3_LEFT), ("right", g1.DEX3_RIGHT))},
    },
    start_q=_with_hands(
        (*_alike(2, _G1_LEG), 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 1.2, 0.0, 0.0, 0.0, 0.0, -0.2, 0.0, 1.2, 0.0, 0.0, 0.0),
        _OPEN, tuple(-q for q in _OPEN),
    ),
    start_height_m=0.785,
    least_height_m=0.4,
    stand_kp=_with_hands(G1.stand_kp, *((1.5,) * 7,) * 2),
    stand_kd=_with_hands(G1.stand_kd, *((0.1,) * 7,) * 2),
    clip_nm=(),
)  # fmt: skip

ROBOTS = {robot.name: robot for robot in (GO2, GO1, H1, H1_10, H1_2, H1_2_12, G1_12, G1_23, G1_DEX3)}
"""All that are served by `adapters.robots.legged.kind`, by the suffix of their keys."""
