"""Where the fake wearer's head, hands and body are at a time: a pure function of the script."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adapters.devices.fakes.pico.script import KeyFrame, Script
from station import registry, rotations
from station.operator.sample import Body, OperatorSample, Pose, Side
from station.protocols import Floats, Motion

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
_AT_REST = ((0.0, 0.0, 0.0), (0.3, 0.2, -0.5), (0.3, -0.2, -0.5))  # head, left and right hand [m]
_SIDES: tuple[Side, ...] = ("left", "right")

Scene = Callable[[float], OperatorSample]
"""What is where at a time [s] of the script; without controls but those of explicit frames."""


def scene_of(script: Script) -> Scene:
    """Return what a script shows, in the frame that its `origin` asks for."""
    if script.motion:
        scene = _of_motion(script)
    elif script.frames:
        scene = _of_frames(script)
    else:
        scene = _at_rest
    return scene if script.origin == "floor" else _from_the_head(scene)


def moved(reading: OperatorSample, shift: Floats, yaw_rad: float) -> OperatorSample:
    """Turn everything about the origin to the left [rad], then shift it (3,) [m]."""
    turn = rotations.from_rotation_vector([0.0, 0.0, yaw_rad])

    def place(positions: Floats) -> Floats:
        return rotations.rotate(turn, positions) + shift

    def pose(item: Pose | None) -> Pose | None:
        return item and Pose(place(item.position), rotations.multiply(turn, item.quat_wxyz))

    body = reading.body
    return replace(
        reading,
        head=pose(reading.head),
        left=pose(reading.left),
        right=pose(reading.right),
        body=body and Body(place(body.positions), rotations.multiply(turn, body.quats_wxyz)),
        hands={
            side: np.concatenate([place(hand[:, :3]), rotations.multiply(turn, hand[:, 3:])], axis=-1)
            for side, hand in reading.hands.items()
        },
    )


def _at_rest(_time_s: float) -> OperatorSample:
    head, left, right = (Pose(np.array(place), _LEVEL) for place in _AT_REST)
    return OperatorSample(head=head, left=left, right=right)


def _from_the_head(scene: Scene) -> Scene:
    """Begin with the head at the origin, looking along x: so the headset's app places its world."""
    head = scene(0.0).head
    if head is None:
        return scene
    yaw_rad = -float(rotations.roll_pitch_yaw(head.quat_wxyz)[2])
    shift = -rotations.rotate(rotations.from_rotation_vector([0.0, 0.0, yaw_rad]), head.position)
    return lambda time_s: moved(scene(time_s), shift, yaw_rad)


def _of_motion(script: Script) -> Scene:
    from adapters.retarget.skeleton import HAND_REST, skeleton_of

    motion: Motion = registry.find("loader", "motion")(script.motion)
    in_hand = dict(zip(_SIDES, (_quat(rest.T) for rest in HAND_REST), strict=True))

    def at(time_s: float) -> OperatorSample:
        body = skeleton_of(motion.at(_motion_time(script, motion.duration_s, time_s)), script.height_m)

        def joint(index: int, after: Floats = _LEVEL) -> Pose:
            return Pose(body.positions[index], rotations.multiply(body.quats_wxyz[index], after))

        return OperatorSample(
            head=joint(_HEAD), left=joint(_LEFT_HAND, in_hand["left"]), right=joint(_RIGHT_HAND, in_hand["right"]),
            body=body,
        )  # fmt: skip

    return at


def _motion_time(script: Script, duration_s: float, time_s: float) -> float:
    if script.repeat == "once" or duration_s <= 0.0:
        return min(time_s, duration_s)
    there_and_back = time_s % (2.0 * duration_s)
    return min(there_and_back, 2.0 * duration_s - there_and_back)


@dataclass(frozen=True, slots=True)
class _Track:
    """Poses of one thing over time."""

    times_s: list[float]
    poses: list[Pose]

    def at(self, time_s: float, *, is_blended: bool) -> Pose | None:
        if not self.times_s:
            return None
        after = bisect.bisect_right(self.times_s, time_s)
        if after == 0 or after == len(self.times_s) or not is_blended:
            return self.poses[max(after - 1, 0)]
        first, second = self.poses[after - 1], self.poses[after]
        part = (time_s - self.times_s[after - 1]) / (self.times_s[after] - self.times_s[after - 1])
        return Pose(
            first.position + (second.position - first.position) * part,
            rotations.slerp(first.quat_wxyz, second.quat_wxyz, part),
        )


def _of_frames(script: Script) -> Scene:
    frames, is_blended = script.frames, script.between == "blend"
    starts_s = [frame.at_s for frame in frames]
    tracks = [_track(frames, name) for name in ("head", "left", "right")]

    def at(time_s: float) -> OperatorSample:
        frame = frames[max(bisect.bisect_right(starts_s, time_s) - 1, 0)]
        head, left, right = (track.at(time_s, is_blended=is_blended) for track in tracks)
        return OperatorSample(
            head=head, left=left, right=right, body=_body(frame), hands=_hands(frame), controls=frame.controls
        )

    return at


def _track(frames: list[KeyFrame], name: str) -> _Track:
    given = [(frame.at_s, getattr(frame, name)) for frame in frames if getattr(frame, name) is not None]
    return _Track(
        [at_s for at_s, _ in given],
        [Pose(np.array(row[:3]), rotations.normalized(row[3:])) for _, row in given],
    )


def _body(frame: KeyFrame) -> Body | None:
    if frame.body is None:
        return None
    return Body(np.array(frame.body.positions), rotations.normalized(frame.body.quats_wxyz))


def _hands(frame: KeyFrame) -> dict[Side, Floats]:
    found: dict[Side, Floats] = {}
    for side in _SIDES:
        rows = getattr(frame.hands, side) if frame.hands is not None else None
        if rows is not None:
            found[side] = np.array(rows, dtype=np.float64)
    return found


def _quat(matrix: Floats) -> Floats:
    """Return the quaternion wxyz of a rotation matrix (3, 3) of quarter turns about (±1, ±1, ±1)."""
    w = np.sqrt(1.0 + np.trace(matrix)) / 2.0
    vector = [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    return np.array([w, *(np.array(vector) / (4.0 * w))])


_HEAD, _LEFT_HAND, _RIGHT_HAND = 15, 22, 23  # in station.bus.joints.SMPL_24
