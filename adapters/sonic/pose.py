"""SONIC's streamed poses of version 1, joint by joint, as TWIST2's whole-body command, and the other way round.

| field | shape | here |
|---|---|---|
| ``body_quat`` | N, 4 or N, bodies, 4 | orientation of the root, wxyz, of which the first body counts |
| ``frame_index`` | N | counts frames of 20 ms; a jump ends what velocities are made of |
| ``joint_pos`` | N, 29 | in Isaac Lab's order [rad] |
| ``joint_vel`` | N, 29 | [rad/s]; not used here: joints are positions |

The newest frame counts. A stream says neither how high the root is nor how fast it goes; TWIST2's command wants both.
They follow from the joints, taken that the lowest points of the feet are on level ground and do not slip: a jump is
seen as a crouch, a slide not at all. Versions 2 to 4 have no meaning here: SMPL bodies, and tokens of SONIC's own
encoder.
"""

from __future__ import annotations

import numpy as np

from adapters.commands.root import CommandedRoot
from adapters.commands.twist2 import FORMAT
from adapters.robots.g1.joints import FROM_ISAAC, G1_29, LEGS, TO_ISAAC
from adapters.robots.g1.kinematics import soles
from adapters.sonic.message import BadMessage, Message, pack
from station.protocols import Floats, Reference
from station.rotations import inverse, multiply, normalized, rotate_inverse, rotation_vector

POSE = "pose"
"""Topic."""

FIELDS = frozenset(("body_quat", "frame_index", "joint_pos", "joint_vel"))
"""That are known here."""

VERSION = 1
FRAME_S = 0.02
MOST_FRAMES = 64
"""Of a message."""

_INTEGERS = ("i32", "i64")
_MOST_MISSING = 10  # frames between two, over which a velocity still says something
_STANCE_M = 0.01  # points that are so near to the lowest one are on the ground
_SMOOTHED_S = 0.06  # of the velocity over ground, which a difference of two frames shakes


class Frame:
    """A frame of a stream: where the robot is asked to be.

    Args:
        index: Its number.
        quat_wxyz: Orientation of the root, shape (4,).
        q: Joint positions in the order of `adapters.robots.g1.joints.G1_29`, shape (29,) [rad].
    """

    def __init__(self, index: int, quat_wxyz: Floats, q: Floats) -> None:
        self.index, self.quat_wxyz, self.q = index, quat_wxyz, q
        self.soles: Floats = soles(quat_wxyz, q[: len(LEGS)])
        """Lowest points of the feet from the root, in the stream's world, shape (8, 3) [m]."""

    @property
    def height(self) -> float:
        """Of the root above the lowest point [m]."""
        return -float(self.soles[:, 2].min())


def frame_of(message: Message) -> Frame:
    """Return the newest frame of a message.

    Raises:
        BadMessage: of another version, a field lacks or is of another type or shape, or holds what is no pose.
    """
    if message.version != VERSION:
        raise BadMessage("wrong-version", f"version {message.version}, expected {VERSION}: joints, no SMPL, no tokens")
    frames = next(iter(message.shape("frame_index")), 0)
    if not 0 < frames <= MOST_FRAMES:
        raise BadMessage("wrong-fields", f"field frame_index: {frames} frames, expected 1 to {MOST_FRAMES}")
    index = message.numbers("frame_index", frames, among=_INTEGERS)
    bodies = message.shape("body_quat")
    shape = (frames, 4) if len(bodies) != 3 else (frames, bodies[1], 4)
    quat = message.numbers("body_quat", *shape).reshape(frames, -1, 4)[-1, 0]
    q = message.numbers("joint_pos", frames, len(G1_29))[-1]
    message.numbers("joint_vel", frames, len(G1_29))
    if not 0.9 < float(np.linalg.norm(quat)) < 1.1:
        raise BadMessage("wrong-fields", f"field body_quat: of length {np.linalg.norm(quat):.3g}, expected 1")
    return Frame(int(index[-1]), normalized(quat), q[FROM_ISAAC])


class PosedMotion:
    """From frames to TWIST2's command.

    Attributes:
        missing: Frames that the numbers say were sent, and did not come.
    """

    def __init__(self) -> None:
        self.missing = 0
        self._last: Frame | None = None
        self._over_ground = np.zeros(2)

    def command(self, frame: Frame) -> Floats:
        """Return the command that asks for a frame, shape (35,)."""
        last, self._last = self._last, frame
        steps = 0 if last is None else frame.index - last.index
        velocity, turn = np.zeros(3), np.zeros(3)
        if last is not None and 0 < steps <= _MOST_MISSING:
            self.missing += steps - 1
            dt_s = steps * FRAME_S
            turn = rotation_vector(multiply(inverse(last.quat_wxyz), frame.quat_wxyz)) / dt_s
            stance = frame.soles[:, 2] < frame.soles[:, 2].min() + _STANCE_M
            moved = -(frame.soles - last.soles)[stance, :2].mean(axis=0) / dt_s
            self._over_ground = self._over_ground + (moved - self._over_ground) * min(1.0, dt_s / _SMOOTHED_S)
            velocity = np.append(self._over_ground, (frame.height - last.height) / dt_s)
        else:
            self._over_ground = np.zeros(2)
        position = np.array([0.0, 0.0, frame.height])
        linear = rotate_inverse(frame.quat_wxyz, velocity)
        return FORMAT.encode(Reference(position, frame.quat_wxyz, linear, turn, frame.q), G1_29)


class StreamedPose:
    """From TWIST2's command to frames, one each 20 ms; height and velocities of the root have no place in them."""

    def __init__(self) -> None:
        self._index, self._root = 0, CommandedRoot()
        self._q: Floats | None = None

    def pack(self, command: Floats, dt_s: float) -> bytes:
        """Return the message of a command, shape (35,), for a period [s]."""
        q = command[6:]
        self._root.advance(command, dt_s)
        speed = np.zeros(len(q)) if self._q is None else (q - self._q) / dt_s
        self._q, self._index = q, self._index + 1
        return pack(POSE, VERSION, {
            "body_quat": self._root.quat_wxyz[None].astype(np.float32),
            "frame_index": np.array([self._index], np.int64),
            "joint_pos": q[None, TO_ISAAC].astype(np.float32), "joint_vel": speed[None, TO_ISAAC].astype(np.float32),
        })  # fmt: skip
