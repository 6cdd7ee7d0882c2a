"""A person from a BVH file, whatever its joints are called and whatever its pose of zero rotations is.

Names are those of MotionBuilder and Mixamo (``LeftUpLeg``, ``LeftForeArm``), CMU, LAFAN1, Xsens (``LeftHip``,
``LeftElbow``), SMPL (``L_Hip``, ``L_Ankle``) and Blender (``thigh.L``); prefixes such as ``mixamorig:`` do not count.
Where the pose of zero rotations is a person who stands, whether the arms are out or hang, it tells how each joint's
frame sits on its bone. Where it is not, as in LAFAN1, that is fitted over all frames to where the joints are.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adapters.captures import bvh_file, geometry
from adapters.captures.bvh_file import Bvh
from adapters.captures.joints import PLACES, Joints
from adapters.retarget.bone_frames import directed
from adapters.retarget.human import SIDES
from station.errors import BadFile
from station.protocols import Floats

_OF_SIDE = {
    "hip": ("upleg", "upperleg", "thigh", "hip"),
    "knee": ("lowleg", "lowerleg", "leg", "shin", "calf", "knee"),
    "ankle": ("ankle", "foot"),
    "ball": ("toebase", "toe", "toe0", "ball", "foot"),
    "shoulder": ("uparm", "upperarm", "arm", "shoulder"),
    "elbow": ("forearm", "lowarm", "lowerarm", "elbow"),
    "wrist": ("wrist", "hand"),
}
"""What a joint is called, behind its side; the first that a file has counts."""

_OF_MIDDLE = {"pelvis": ("hips", "pelvis", "hip", "root"), "neck": ("neck", "neck1", "neck01"), "head": ("head",)}
_BEHIND = re.compile(r"(?P<word>.+)[ _.-](?P<side>left|right|l|r)")
_BEFORE = re.compile(r"(?P<side>left|right|l|r)[ _.-]?(?P<word>.+)")
_PREFIX = re.compile(r"^(.*:)?(bip\d+[ _]?)?")
_STANDS = math.cos(math.radians(30.0))
_BENT = 0.2  # part of the frames, those with the elbow bent most, that show about which axis


def load(path: Path, *, height_m: float | None = None) -> Joints:
    """Read a person; the file says how it is proportioned, and needs no height.

    Raises:
        BadFile: no BVH, or not of a person.
    """
    del height_m
    bvh = bvh_file.load(path)
    joints = _found(bvh)
    places, turns = bvh.poses()
    rest_places, rest_turns = bvh.rest()
    at = {name: places[index] for name, index in joints.places.items()}
    up = _stands(joints, rest_places[:, 0])
    if up is None:
        fits = _fitted(joints, at, turns)
        note = "no standing person in its pose of zero rotations: how joints sit on bones is fitted to all frames"
    else:
        fits = _from_rest(joints, rest_places[:, 0], rest_turns[:, 0], up)
        note = ""
    return Joints(
        path=path,
        fps=1.0 / bvh.frame_s,
        places=at,
        turns={name: turns[joints.turns[name]] @ fit for name, fit in fits.items()},
        notes=(note,) if note else (),
    )


@dataclass(frozen=True, slots=True)
class _Found:
    """Places in `Bvh.nodes` of the joints of a person, and of the joints that turn its parts."""

    places: dict[str, int]
    turns: dict[str, int]


def _found(bvh: Bvh) -> _Found:
    sided: dict[tuple[str, str], int] = {}
    middle: dict[str, int] = {}
    for index, node in enumerate(bvh.nodes):
        name = _PREFIX.sub("", node.name.lower())
        if match := _BEHIND.fullmatch(name) or _BEFORE.fullmatch(name):
            side = "left" if match["side"].startswith("l") else "right"
            sided.setdefault((side, re.sub(r"[ _.-]", "", match["word"])), index)
        middle.setdefault(re.sub(r"[ _.-]", "", name), index)
    places = {}
    for side in SIDES:
        taken: set[int] = set()
        for joint, words in _OF_SIDE.items():
            found = [sided[side, word] for word in words if (side, word) in sided]
            if found and found[0] not in taken:
                places[f"{side}_{joint}"] = found[0]
                taken.add(found[0])
    for joint, words in _OF_MIDDLE.items():
        if found := [middle[word] for word in words if word in middle]:
            places[joint] = found[0]
    return _completed(bvh, places)


def _completed(bvh: Bvh, places: dict[str, int]) -> _Found:
    """Find what has no name of its own: the chest carries both shoulders, an end behind the ankle is the ball."""
    for side in SIDES:
        if f"{side}_ball" not in places and (ankle := places.get(f"{side}_ankle")) is not None:
            places[f"{side}_ball"] = next((i for i, node in enumerate(bvh.nodes) if node.parent == ankle), -1)
    if "head" not in places and "neck" in places:
        places["head"] = next((i for i, node in enumerate(bvh.nodes) if node.parent == places["neck"]), -1)
    if "neck" not in places and "head" in places:
        places["neck"] = bvh.nodes[places["head"]].parent
    places.setdefault("pelvis", 0)
    missing = [name for name in PLACES if places.get(name, -1) < 0]
    if missing:
        names = ", ".join(node.name for node in bvh.nodes if not node.name.endswith("_end"))
        raise BadFile(
            f"{bvh.path}: no joint is the {missing[0].replace('_', ' ')} of a person; expected names as in "
            f"LeftUpLeg, LeftForeArm or L_Hip, L_Elbow; came {names[:200]}"
        )
    chains = [list(_chain(bvh, places[f"{side}_shoulder"])) for side in SIDES]
    chest = next(index for index in chains[0] if index in chains[1])
    turns = {"pelvis": places["pelvis"], "chest": chest}
    for side in SIDES:
        turns |= {f"{side}_foot": places[f"{side}_ankle"], f"{side}_hand": places[f"{side}_wrist"]}
    return _Found(places, turns)


def _chain(bvh: Bvh, index: int) -> list[int]:
    chain = []
    while index >= 0:
        chain.append(index)
        index = bvh.nodes[index].parent
    return chain


def _stands(joints: _Found, rest: Floats) -> Floats | None:
    """Return the up direction of the pose of zero rotations, shape (3,); None if nobody stands in it."""
    at = {name: rest[index] for name, index in joints.places.items()}
    ankles = 0.5 * (at["left_ankle"] + at["right_ankle"])
    up = geometry.axis_up(at["head"][None], ankles[None])
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    bones = [at["head"] - hips, at["left_hip"] - at["left_ankle"], at["right_hip"] - at["right_ankle"]]
    return up if all(float(directed(bone) @ up) > _STANDS for bone in bones) else None


def _from_rest(joints: _Found, rest: Floats, turns: Floats, up: Floats) -> dict[str, Floats]:
    """Return how the joints' frames sit on a person, by the pose of zero rotations, each of shape (3, 3)."""
    at = {name: rest[index] for name, index in joints.places.items()}
    body = geometry.upright(up, at["left_hip"] - at["right_hip"])
    fits = {"pelvis": body, "chest": body}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        fits[f"{side}_foot"] = geometry.level_foot(at[f"{side}_ankle"], at[f"{side}_ball"], up)
        hanging = geometry.turn_between(sign * body[:, 1], at[f"{side}_wrist"] - at[f"{side}_elbow"])
        fits[f"{side}_hand"] = hanging @ body
    return {name: turns[joints.turns[name]].T @ fit for name, fit in fits.items()}


def _fitted(joints: _Found, at: dict[str, Floats], turns: Floats) -> dict[str, Floats]:
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
