"""Motions that need no file: made from a few parameters, in which every foot that carries stands still."""

from __future__ import annotations

import hashlib
from typing import Any

from adapters.motions.builtin.body import FORMAT
from adapters.motions.builtin.clips import CLIPS, HELD_BACK, PREFIX, join, made, parts
from adapters.motions.builtin.gait import gait
from adapters.motions.builtin.plan import WalkPlan
from adapters.motions.builtin.postures import Posture, postures
from adapters.motions.raw import RawMotion
from station.errors import UnknownName

__all__ = [
    "FORMAT", "HELD_BACK", "Posture", "WalkPlan",
    "facts", "gait", "is_named", "join", "make", "names", "postures", "sha256",
]  # fmt: skip


def names() -> tuple[str, ...]:
    """Return the names of all motions, without their prefix."""
    return tuple(CLIPS)


def is_named(reference: str) -> bool:
    """Whether a reference names a motion that is made rather than read."""
    return reference.startswith(PREFIX)


def make(reference: str) -> RawMotion:
    """Return the motion that ``builtin:NAME`` names; it is made once, and its arrays are read-only.

    Raises:
        UnknownName: there is none of that name.
    """
    return made(expect(reference))


def expect(reference: str) -> str:
    """Return the name of a motion that ``builtin:NAME`` names.

    Raises:
        UnknownName: there is none of that name.
    """
    name = reference.removeprefix(PREFIX)
    if name not in CLIPS:
        raise UnknownName("built-in motion", name, CLIPS)
    return name


def facts(reference: str) -> dict[str, Any]:
    """Return what a manifest says of such a motion beyond what it says of any: the parts of one that has parts."""
    found = parts(reference.removeprefix(PREFIX))
    return {"clips": [part._asdict() for part in found]} if found else {}


def sha256(motion: RawMotion) -> str:
    """Return a hash of the frames, in place of a file's."""
    return hashlib.sha256(b"".join(a.tobytes() for a in (motion.root_pos, motion.root_quat_wxyz, motion.q))).hexdigest()
