"""Motions that need no file: made from a few sines around the standing pose, for a first look and for tests."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from adapters.motions.raw import RawMotion
from station.bus.joints import G1_29
from station.errors import UnknownName
from station.protocols import Floats

FORMAT = "builtin"
_PREFIX = "builtin:"
_FPS = 50.0
_STANDING_HEIGHT_M = 0.79

_STANDING_Q: dict[str, float] = {
    "hip_pitch": -0.2, "knee": 0.4, "ankle_pitch": -0.2, "elbow": 1.2,
    "left_shoulder_roll": 0.4, "right_shoulder_roll": -0.4,
}  # fmt: skip


def is_named(reference: str) -> bool:
    """Whether a reference names a motion that is made rather than read."""
    return reference.startswith(_PREFIX)


def make(reference: str) -> RawMotion:
    """Return the motion that ``builtin:NAME`` names.

    Raises:
        UnknownName: there is none of that name.
    """
    name = reference.removeprefix(_PREFIX)
    if name not in _MOTIONS:
        raise UnknownName("built-in motion", name, _MOTIONS)
    root_height_m, q = _MOTIONS[name]()
    root_pos = np.zeros((len(q), 3))
    root_pos[:, 2] = root_height_m
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1))
    return RawMotion(Path(reference), FORMAT, _FPS, root_pos, quat, q)


def sha256(motion: RawMotion) -> str:
    """Return a hash of the frames, in place of a file's."""
    return hashlib.sha256(b"".join(a.tobytes() for a in (motion.root_pos, motion.root_quat_wxyz, motion.q))).hexdigest()


def _wave() -> tuple[Floats, Floats]:
    """Raise the right arm, wave three times, lower it: 6 s."""
    time_s = np.arange(0.0, 6.0, 1.0 / _FPS)
    q = _standing(len(time_s))
    raised = _plateau(time_s, 6.0, rise_s=1.5)
    _add(q, "right_shoulder_roll", -1.2 * raised)
    _add(q, "right_shoulder_yaw", 0.5 * raised)
    _add(q, "right_elbow", raised * (-0.4 + 0.4 * np.sin(2 * np.pi * time_s)))
    return np.full(len(time_s), _STANDING_HEIGHT_M), q


def _squat() -> tuple[Floats, Floats]:
    """Bend the knees by 0.7 rad and straighten them, twice: 8 s."""
    time_s = np.arange(0.0, 8.0, 1.0 / _FPS)
    q = _standing(len(time_s))
    bend = 0.35 * (1.0 - np.cos(2 * np.pi * time_s / 4.0))
    for side in ("left", "right"):
        _add(q, f"{side}_hip_pitch", -0.5 * bend)
        _add(q, f"{side}_knee", bend)
        _add(q, f"{side}_ankle_pitch", -0.5 * bend)
    # Thigh and shank are about 0.3 m each: bending the knee from 0.4 to 0.4 + b lowers the hip by this much.
    return _STANDING_HEIGHT_M - 0.6 * (np.cos(0.2) - np.cos(0.2 + bend / 2)), q


def _standing(frames: int) -> Floats:
    pose = [next((value for name, value in _STANDING_Q.items() if joint.endswith(name)), 0.0) for joint in G1_29]
    return np.tile(pose, (frames, 1))


def _plateau(time_s: Floats, end_s: float, *, rise_s: float) -> Floats:
    """Rise smoothly from 0 to 1 and fall again, with zero speed at both ends of each slope."""
    slope = np.clip(np.minimum(time_s, end_s - time_s) / rise_s, 0.0, 1.0)
    return np.asarray(slope * slope * (3.0 - 2.0 * slope))


def _add(q: Floats, joint: str, values: Floats) -> None:
    q[:, G1_29.index(joint)] += values


_MOTIONS: dict[str, Callable[[], tuple[Floats, Floats]]] = {"squat": _squat, "wave": _wave}
