"""Finds a person's joints in a named tree, and how each joint's frame is turned when the person stands at rest.

Names are those of MotionBuilder, Mixamo, CMU, LAFAN1, Xsens, SMPL and Blender (see `adapters.captures.bvh`), and of
OptiTrack's Motive (``LThigh``, ``LUArm``, ``LFArm``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from adapters.captures import geometry
from adapters.captures.joints import PLACES
from adapters.retarget.bone_frames import directed
from adapters.retarget.human import SIDES
from station.errors import BadFile
from station.protocols import Floats

_OF_SIDE = {
    "hip": ("upleg", "upperleg", "thigh", "hip"),
    "knee": ("lowleg", "lowerleg", "leg", "shin", "calf", "knee"),
    "ankle": ("ankle", "foot"),
    "ball": ("toebase", "toe", "toe0", "ball", "foot"),
    "shoulder": ("uparm", "upperarm", "uarm", "arm", "shoulder"),
    "elbow": ("forearm", "farm", "lowarm", "lowerarm", "elbow"),
    "wrist": ("wrist", "hand"),
}
"""What a joint is called, behind its side; the first that a tree has counts."""

_OF_MIDDLE = {"pelvis": ("hips", "pelvis", "hip", "root"), "neck": ("neck", "neck1", "neck01"), "head": ("head",)}
_BEHIND = re.compile(r"(?P<word>.+)[ _.-](?P<side>left|right|l|r)")
_BEFORE = re.compile(r"(?P<side>left|right|l|r)[ _.-]?(?P<word>.+)")
_PREFIX = re.compile(r"^(.*:)?(bip\d+[ _]?)?")
_STANDS = math.cos(math.radians(30.0))


@dataclass(frozen=True, slots=True)
class Found:
    """Places in a tree of the joints of a person, and of those that turn its parts.

    Attributes:
        places: By each name of `adapters.captures.joints.PLACES`, and ``pelvis``.
        turns: By each name of `adapters.captures.joints.TURNS`.
    """

    places: dict[str, int]
    turns: dict[str, int]


def find(names: Sequence[str], parents: Sequence[int], where: str) -> Found:
    """Return which joints of a tree are which of a person.

    Args:
        names: Of the joints.
        parents: Place of each one's parent, -1 for a root.
        where: The tree's file or actor, for the message of an error.

    Raises:
        BadFile: it is no person.
    """
    sided: dict[tuple[str, str], int] = {}
    middle: dict[str, int] = {}
    for index, given in enumerate(names):
        name = _PREFIX.sub("", given.lower())
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
    return _completed(names, parents, where, places)


def _completed(names: Sequence[str], parents: Sequence[int], where: str, places: dict[str, int]) -> Found:
    """Find what has no name of its own: the chest carries both shoulders, an end behind the ankle is the ball."""
    for side in SIDES:
        if f"{side}_ball" not in places and (ankle := places.get(f"{side}_ankle")) is not None:
            places[f"{side}_ball"] = next((i for i, parent in enumerate(parents) if parent == ankle), -1)
    if "head" not in places and "neck" in places:
        places["head"] = next((i for i, parent in enumerate(parents) if parent == places["neck"]), -1)
    if "neck" not in places and "head" in places:
        places["neck"] = parents[places["head"]]
    places.setdefault("pelvis", 0)
    missing = [name for name in PLACES if places.get(name, -1) < 0]
    if missing:
        listed = ", ".join(name for name in names if not name.endswith("_end"))
        raise BadFile(
            f"{where}: no joint is the {missing[0].replace('_', ' ')} of a person; expected names as in "
            f"LeftUpLeg, LeftForeArm or L_Hip, L_Elbow; came {listed[:200]}"
        )
    chains = [list(_chain(parents, places[f"{side}_shoulder"])) for side in SIDES]
    chest = next((index for index in chains[0] if index in chains[1]), -1)
    if chest < 0:
        raise BadFile(f"{where}: no joint carries both shoulders; expected one tree from the pelvis outwards")
    turns = {"pelvis": places["pelvis"], "chest": chest}
    for side in SIDES:
        turns |= {f"{side}_foot": places[f"{side}_ankle"], f"{side}_hand": places[f"{side}_wrist"]}
    return Found(places, turns)


def _chain(parents: Sequence[int], index: int) -> list[int]:
    chain = []
    while index >= 0:
        chain.append(index)
        index = parents[index]
    return chain


def stands(joints: Found, rest: Floats) -> Floats | None:
    """Return the up direction of a rest pose, shape (3,); None if it is not the pose of a standing person.

    Args:
        joints: As found.
        rest: Where all joints of the tree are in it, shape (m, 3).
    """
    at = {name: rest[index] for name, index in joints.places.items()}
    ankles = 0.5 * (at["left_ankle"] + at["right_ankle"])
    up = geometry.axis_up(at["head"][None], ankles[None])
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    bones = [at["head"] - hips, at["left_hip"] - at["left_ankle"], at["right_hip"] - at["right_ankle"]]
    return up if all(float(directed(bone) @ up) > _STANDS for bone in bones) else None


def from_rest(joints: Found, rest: Floats, turns: Floats, up: Floats) -> dict[str, Floats]:
    """Return the rotation from each joint's frame in the rest pose to that of a standing person, shape (3, 3) each.

    Args:
        joints: As found.
        rest: Where all joints of the tree are in it, shape (m, 3).
        turns: How they are turned in it, shape (m, 3, 3).
        up: As `stands` returns it.
    """
    at = {name: rest[index] for name, index in joints.places.items()}
    body = geometry.upright(up, at["left_hip"] - at["right_hip"])
    fits = {"pelvis": body, "chest": body}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        fits[f"{side}_foot"] = geometry.level_foot(at[f"{side}_ankle"], at[f"{side}_ball"], up)
        hanging = geometry.turn_between(sign * body[:, 1], at[f"{side}_wrist"] - at[f"{side}_elbow"])
        fits[f"{side}_hand"] = hanging @ body
    return {name: turns[joints.turns[name]].T @ fit for name, fit in fits.items()}
