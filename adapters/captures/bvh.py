"""A person from a BVH file, whatever its joints are called and whatever its pose of zero rotations is.

Names are those of MotionBuilder and Mixamo (``LeftUpLeg``, ``LeftForeArm``), CMU, LAFAN1, Xsens (``LeftHip``,
``LeftElbow``), SMPL (``L_Hip``, ``L_Ankle``) and Blender (``thigh.L``); prefixes such as ``mixamorig:`` do not count.
Where the pose of zero rotations is a person who stands, whether the arms are out or hang, it tells how each joint's
frame sits on its bone. Where it is not, as in LAFAN1, that is fitted over all frames to where the joints are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.captures import bvh_file, geometry, skeleton_tree
from adapters.captures.joints import Joints
from adapters.captures.skeleton_tree import Found
from adapters.retarget.bone_frames import directed
from adapters.retarget.human import SIDES
from station.protocols import Floats

_BENT = 0.2  # part of the frames, those with the elbow bent most, that show about which axis


def load(path: Path, *, height_m: float | None = None) -> Joints:
    """Read a person; the file says how it is proportioned, and needs no height.

    Raises:
        BadFile: no BVH, or not of a person.
    """
    del height_m
    bvh = bvh_file.load(path)
    joints = skeleton_tree.find([node.name for node in bvh.nodes], [node.parent for node in bvh.nodes], str(bvh.path))
    places, turns = bvh.poses()
    rest_places, rest_turns = bvh.rest()
    at = {name: places[index] for name, index in joints.places.items()}
    up = skeleton_tree.stands(joints, rest_places[:, 0])
    if up is None:
        fits = _fitted(joints, at, turns)
        note = "no standing person in its pose of zero rotations: how joints sit on bones is fitted to all frames"
    else:
        fits = skeleton_tree.from_rest(joints, rest_places[:, 0], rest_turns[:, 0], up)
        note = ""
    return Joints(
        path=path,
        fps=1.0 / bvh.frame_s,
        places=at,
        turns={name: turns[joints.turns[name]] @ fit for name, fit in fits.items()},
        notes=(note,) if note else (),
    )


def _fitted(joints: Found, at: dict[str, Floats], turns: Floats) -> dict[str, Floats]:
    """Return the same by all frames: what joints' places say of the parts, where they say it best."""
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    ankles = 0.5 * (at["left_ankle"] + at["right_ankle"])
    up = geometry.axis_up(at["head"], ankles)
    wanted = {
        "pelvis": geometry.upright(at["neck"] - hips, at["left_hip"] - at["right_hip"]),
        "chest": geometry.upright(at["neck"] - hips, at["left_shoulder"] - at["right_shoulder"]),
    }
    fits = {name: geometry.fitted(turns[joints.turns[name]], frames) for name, frames in wanted.items()}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        foot, hand = turns[joints.turns[f"{side}_foot"]], turns[joints.turns[f"{side}_hand"]]
        flat = geometry.lowest((at[f"{side}_ankle"] + at[f"{side}_ball"]) @ up)
        level = geometry.level_foot(at[f"{side}_ankle"], at[f"{side}_ball"], up)
        fits[f"{side}_foot"] = geometry.fitted(foot[flat], level[flat])
        upper = at[f"{side}_elbow"] - at[f"{side}_shoulder"]
        fore = at[f"{side}_wrist"] - at[f"{side}_elbow"]
        hinge = -sign * np.cross(directed(upper), directed(fore))  # an elbow that bends tells where its back is
        bent = np.linalg.norm(hinge, axis=1)
        told = bent >= np.quantile(bent, 1.0 - _BENT)
        fits[f"{side}_hand"] = geometry.fitted(hand[told], geometry.arm(sign, fore, hinge)[told])
    return fits
