"""``modality.json`` for GR00T: which slice of state and action is which part of the body, from the contracts' names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

from adapters.exports.lerobot.plan import IMAGES, Common

_LIMBS = {
    "leg": ("hip", "knee", "ankle"),
    "arm": ("shoulder", "elbow", "wrist"),
    "hand": ("hand",),
}
_QUANTITY = re.compile(r"_(pos|vel|kp|kd|pos_from_default|previous_action)$")
_ELEMENT = re.compile(r"_(x|y|z|w|roll|pitch|yaw|\d+)$")
_SCALED = "scaled_"
_LANGUAGE = "human.task_description"


def modality(common: Common) -> dict[str, Any]:
    """Return the document: groups of consecutive numbers for state and action, cameras, and where the task stands."""
    return {
        "state": groups(common.state_names),
        "action": groups(common.action_names),
        "video": {camera.name: {"original_key": IMAGES + camera.name} for camera in common.cameras},
        "annotation": {_LANGUAGE: {"original_key": "task_index"}},
    }


def groups(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return start and end (exclusive) of each group of consecutive names that belong together, by its name."""
    found: dict[str, dict[str, int]] = {}
    last = ""
    for index, name in enumerate(names):
        group = group_of(name)
        if group == last:
            next(reversed(found.values()))["end"] = index + 1
        else:
            found[_free(group, found)] = {"start": index, "end": index + 1}
        last = group
    return found


def group_of(name: str) -> str:
    """Return the part of the body, or of the root, that an element belongs to, with ``_vel`` … for no position."""
    name = name.rpartition(".")[2]  # without the key
    quantity = _QUANTITY.search(name)
    joint = name[: quantity.start()] if quantity else name
    suffix = f"_{quantity[1]}" if quantity and quantity[1] != "pos" else ""
    prefix = _SCALED if joint.startswith(_SCALED) else ""
    return prefix + _part(joint.removeprefix(prefix), is_joint=quantity is not None) + suffix


def _part(joint: str, *, is_joint: bool) -> str:
    words = joint.split("_")
    side = f"{words[0]}_" if words[0] in ("left", "right") else ""
    if is_joint:
        rest = words[1:] if side else words
        limb = next((limb for limb, joints in _LIMBS.items() if rest and rest[0] in joints), None)
        return side + (limb or (rest or words)[0])
    if words[0] == "root" and "quat" not in words:
        return "root"
    while _ELEMENT.search(joint):
        joint = _ELEMENT.sub("", joint)
    return joint


def _free(name: str, taken: Iterable[str]) -> str:
    """Return a name that is not taken: with a number behind it where the same part comes again."""
    names, number = set(taken), 2
    if name not in names:
        return name
    while f"{name}_{number}" in names:
        number += 1
    return f"{name}_{number}"
