"""The motions that have a name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adapters.motions.builtin.body import FORMAT
from adapters.motions.builtin.gait import gait
from adapters.motions.builtin.plan import WalkPlan
from adapters.motions.builtin.postures import Posture, postures
from adapters.motions.builtin.profiles import FPS
from adapters.motions.raw import RawMotion
from station import rotations
from station.errors import UsageError

PREFIX = "builtin:"
"""What a reference to one of them begins with."""

HELD_BACK = ("walk-arc", "walk-fast", "walk-diagonal")
"""Motions that no policy of ours is trained on, so that they tell how it does with what it does not know."""

TOUR = ("stand", "wave", "reach-both", "squat", "walk-forward", "turn-left", "walk-left", "bow", "stand")
"""What the tour shows, in this order."""

Joints = dict[str, float]


def _both(**left: float) -> Joints:
    """Joints of both arms from those of the left one: rolls and yaws are mirrored."""
    joints = {}
    for name, value in left.items():
        joints[f"left_{name}"] = value
        joints[f"right_{name}"] = -value if name.endswith(("roll", "yaw")) else value
    return joints


def _one(side: str, **left: float) -> Joints:
    return {name: value for name, value in _both(**left).items() if name.startswith(side)}


_REACH = {"shoulder_pitch": -1.15, "shoulder_roll": 0.12, "elbow": 1.25}


def _stand(name: str) -> RawMotion:
    return postures(Posture(hold_s=2.0), name=name)


def _wave(name: str) -> RawMotion:
    raised = {"shoulder_pitch": -0.5, "shoulder_roll": 1.3, "shoulder_yaw": 0.6}
    outward, inward = (_one("right", **raised, elbow=elbow) for elbow in (0.15, -0.6))
    swings = [Posture(move_s=0.45, joints=joints) for joints in (inward, outward) * 3]
    return postures(Posture(move_s=1.4, joints=outward), *swings, Posture(move_s=1.4), name=name)


def _reach(joints: Joints) -> Callable[[str], RawMotion]:
    return lambda name: postures(Posture(move_s=1.5, hold_s=1.0, joints=joints), Posture(move_s=1.5), name=name)


def _squat(name: str) -> RawMotion:
    joints = _both(shoulder_pitch=-0.9, shoulder_roll=0.2, elbow=1.2) | {"waist_pitch": 0.2}
    down = Posture(move_s=2.2, hold_s=0.6, height=0.52, pitch=0.2, joints=joints)
    return postures(down, Posture(move_s=2.2), name=name)


def _look_around(name: str) -> RawMotion:
    left, right = ({"waist_yaw": yaw} for yaw in (0.8, -0.8))
    return postures(
        Posture(move_s=1.2, hold_s=0.4, joints=left), Posture(move_s=2.0, hold_s=0.4, joints=right),
        Posture(move_s=1.2), name=name,
    )  # fmt: skip


def _sway(name: str) -> RawMotion:
    """The weight goes over one foot and the other; as in walking, the hip above the free leg drops a little."""
    left, right = (
        Posture(move_s=1.5, hold_s=0.2, shift_y=side * 0.07, roll=side * 0.05, joints={"waist_roll": -side * 0.05})
        for side in (1, -1)
    )
    return postures(left, right, left, right, Posture(move_s=1.2), name=name)


def _bow(name: str) -> RawMotion:
    down = Posture(move_s=1.5, hold_s=0.6, pitch=0.35, height=0.76, joints={"waist_pitch": 0.4})
    return postures(down, Posture(move_s=1.5), name=name)


def _walk(*plans: WalkPlan) -> Callable[[str], RawMotion]:
    return lambda name: gait(*plans, name=name)


def _turn(yaw_rate: float) -> Callable[[str], RawMotion]:
    """A quarter turn; of its ramps, a half each counts."""
    plan = WalkPlan(yaw_rate=yaw_rate)
    return _walk(replace(plan, duration_s=math.pi / 2 / abs(yaw_rate) + plan.ramp_s))


def _tour(name: str) -> RawMotion:
    return join(*(made(part) for part in TOUR), name=name)


@lru_cache(maxsize=32)
def made(name: str) -> RawMotion:
    """Return the motion of a name in `CLIPS`; its arrays are read-only, since all callers share them."""
    motion = CLIPS[name](f"{PREFIX}{name}")
    for frames in (motion.root_pos, motion.root_quat_wxyz, motion.q):
        frames.flags.writeable = False
    return motion


class Part(NamedTuple):
    """A clip within another one, in the other's time [s]."""

    name: str
    start_s: float
    end_s: float


def parts(name: str) -> list[Part]:
    """Return the clips that a motion is made of, in their order; none for one that is no tour."""
    shown = TOUR if name == "tour" else ()
    ends = list(accumulate((len(made(part)) - 1 for part in shown), initial=0))
    return [Part(part, start / FPS, end / FPS) for part, (start, end) in zip(shown, pairwise(ends), strict=True)]


CLIPS: dict[str, Callable[[str], RawMotion]] = {
    "stand": _stand,
    "wave": _wave,
    "reach-left": _reach(_one("left", **_REACH)),
    "reach-right": _reach(_one("right", **_REACH)),
    "reach-both": _reach(_both(**_REACH)),
    "squat": _squat,
    "look-around": _look_around,
    "sway": _sway,
    "bow": _bow,
    "march": _walk(WalkPlan(duration_s=4.5, clearance=0.08)),
    "walk-forward": _walk(WalkPlan(velocity_x=0.5, duration_s=6.0)),
    "walk-back": _walk(WalkPlan(velocity_x=-0.3, duration_s=6.0)),
    "walk-left": _walk(WalkPlan(velocity_y=0.2, duration_s=6.0)),
    "walk-right": _walk(WalkPlan(velocity_y=-0.2, duration_s=6.0)),
    "turn-left": _turn(0.5),
    "turn-right": _turn(-0.5),
    "walk-arc": _walk(WalkPlan(velocity_x=0.45, yaw_rate=0.4, duration_s=6.0)),
    "walk-fast": _walk(WalkPlan(velocity_x=0.8, duration_s=6.0, ramp_s=1.2)),
    "walk-diagonal": _walk(WalkPlan(velocity_x=0.35, velocity_y=0.18, duration_s=6.0)),
    "tour": _tour,
}
"""How each is made, by name; each takes the name that its motion shall have."""


def join(*motions: RawMotion, name: str = "joined") -> RawMotion:
    """Return motions that begin and end in the standing pose as one, each going on where the one before stood still.

    Args:
        motions: At the frame rate of this package.
        name: Of the result.

    Raises:
        UsageError: no motion.
    """
    if not motions:
        raise UsageError(f"{name}: nothing to join; give at least one motion")
    position, quats, q = [motions[0].root_pos], [motions[0].root_quat_wxyz], [motions[0].q]
    for motion in motions[1:]:
        turn = rotations.multiply(quats[-1][-1], rotations.inverse(motion.root_quat_wxyz[0]))
        shift = position[-1][-1] - rotations.rotate(turn, motion.root_pos[0])
        position.append(rotations.rotate(turn, motion.root_pos[1:]) + shift)
        quats.append(rotations.multiply(turn, motion.root_quat_wxyz[1:]))
        q.append(motion.q[1:])
    return RawMotion(Path(name), FORMAT, FPS, np.concatenate(position), np.concatenate(quats), np.concatenate(q))
