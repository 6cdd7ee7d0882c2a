"""A script of what was recorded: an episode's samples, to be worn again by the fake headset."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from adapters.devices.fakes.pico.script import Hands, KeyFrame, Script, Skeleton
from adapters.devices.pico.controls import CONTROLS
from station.operator.sample import Body, OperatorSample, Pose


def script(readings: Iterable[tuple[float, OperatorSample]]) -> bytes:
    """Return the script, as a file holds it, of samples with their times, in order [s]; the first one is its start.

    Controls that a headset does not have are left out.
    """
    frames: list[KeyFrame] = []
    began_s = None
    for time_s, reading in readings:
        began_s = time_s if began_s is None else began_s
        frames.append(_frame(time_s - began_s, reading))
    return msgspec.json.encode(Script(frames=frames, between="hold", origin="floor"))


def _frame(at_s: float, reading: OperatorSample) -> KeyFrame:
    hands = {side: hand.tolist() for side, hand in reading.hands.items()}
    return KeyFrame(
        at_s=at_s,
        head=_pose(reading.head),
        left=_pose(reading.left),
        right=_pose(reading.right),
        body=_skeleton(reading.body),
        hands=Hands(left=hands.get("left"), right=hands.get("right")) if hands else None,
        controls={name: value for name, value in reading.controls.items() if name in CONTROLS},
    )


def _pose(pose: Pose | None) -> list[float] | None:
    return None if pose is None else [*pose.position.tolist(), *pose.quat_wxyz.tolist()]


def _skeleton(body: Body | None) -> Skeleton | None:
    return None if body is None else Skeleton(positions=body.positions.tolist(), quats_wxyz=body.quats_wxyz.tolist())
