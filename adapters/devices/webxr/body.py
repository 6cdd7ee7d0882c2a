"""A whole body, of the places that a browser gives of 21 of its 83 joints.

Only places are taken. What a browser's joint is turned by when nobody moves is not told by the draft (W3C, WebXR Body
Tracking Module, which has the names) and has been seen on no headset here. So orientations are made of the places, as
of the markers of a capture: pelvis and chest by the spine and the line across, hands by wrist and knuckles, feet level.
"""

from __future__ import annotations

import numpy as np

from adapters.captures import geometry
from adapters.captures.captured import bodies
from adapters.retarget.human import SIDES
from station.operator.sample import Body
from station.protocols import Floats

PLACES = {
    "hip": "upper-leg", "knee": "lower-leg", "ankle": "foot-ankle", "ball": "foot-ball",
    "shoulder": "arm-upper", "elbow": "arm-lower", "wrist": "hand-wrist",
}  # fmt: skip
"""Names of a limb's joints in WebXR, by ours."""

KNUCKLES = ("hand-index-metacarpal", "hand-little-metacarpal")
"""Of a hand, those that say how it is turned."""

JOINTS = (
    "head", "neck", "spine-middle", *(f"{side}-{name}" for name in (*PLACES.values(), *KNUCKLES) for side in SIDES),
)  # fmt: skip
"""In the order of a frame."""


def body_of(places: Floats) -> Body:
    """Return the body of the places of `JOINTS`, shape (21, 3), in the operator's world [m]."""
    of = {name: places[index][np.newaxis] for index, name in enumerate(JOINTS)}
    at = {"neck": of["neck"], "head": of["head"]}
    for side in SIDES:
        at |= {f"{side}_{ours}": of[f"{side}-{theirs}"] for ours, theirs in PLACES.items()}
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    turns = {
        "pelvis": geometry.upright(of["spine-middle"] - hips, at["left_hip"] - at["right_hip"]),
        "chest": geometry.upright(of["neck"] - of["spine-middle"], at["left_shoulder"] - at["right_shoulder"]),
    }
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        turns[f"{side}_foot"] = geometry.level_foot(at[f"{side}_ankle"], at[f"{side}_ball"], np.array([0.0, 0.0, 1.0]))
        index, little = (of[f"{side}-{name}"] for name in KNUCKLES)
        towards = 0.5 * (index + little) - at[f"{side}_wrist"]
        turns[f"{side}_hand"] = geometry.arm(sign, towards, sign * np.cross(index - little, towards))
    positions, quats = bodies(at, turns)
    return Body(positions[0], quats[0])
