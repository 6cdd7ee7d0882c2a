"""The pose server of motion_tracking's teleoperation, over ZeroMQ: it is asked for each pose of the robot, and answers.

| port | the robot | what |
|---|---|---|
| 28701 | pushes | ``{"start": true}``, or false: the question for a pose |
| 28702 | pulls | two parts: ``{"start", "num_frames", "qpos_size"}``, and the frames as float32 |
| 28703 | pulls | ``{"t_ms", "controller_buttons"}``: ``right_key_one`` begins, ``left_key_one`` ends |

A frame is the place [m] and the orientation (wxyz) of the root, and 29 joints in Unitree's order [rad]. The server
listens on all three. It says no time, but answers a question with the pose of when it got that, so a pose is at most as
old as its question. Of several questions that wait it answers the newest, as one that begins if any of them does.

Both sides are here: `PoseServer` is theirs, which we ask, `AskingRobot` theirs, which asks us. There can be one robot:
ZeroMQ gives answers and buttons by turns to all that are connected.

Facts: Axellwppr/motion_tracking, its second generation (commit 0d5ba31), ``serve_xrobot_teleop.py`` and
``runtime/motion_sources.py``.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import struct
from collections import Counter
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from adapters import zeromq
from adapters.commands.twist2 import FORMAT
from adapters.robots.g1.joints import G1_29
from station.protocols import Floats, Reference
from station.rotations import inverse, multiply, normalized, rotate_inverse, rotation_vector

PORTS = (28701, 28702, 28703)
QPOS = 7 + len(G1_29)

ASK_S = 0.02
"""A pose is asked for so often [s]."""

UNANSWERED_S = 0.1
"""A question without an answer for so long is asked anew [s]."""

_MOST_FRAMES = 64
_MOST_TOLD = 1 << 16  # bytes of JSON
_BACKLOG = 16
_QUEUED, _KERNEL_BYTES = 2, 4096  # for a robot that does not read: answers and buttons of before are worse than none
_LAST_WORD_MS = 200  # for who reads at once
_SMOOTHED_S = 0.06  # of the velocity of the root, which a difference of two poses shakes
_LONGEST_STEP_S = 0.2  # between two poses, over which a velocity still says something

State = Literal["waiting", "starting", "following"]


class BadPose(ValueError):
    """An answer that is none."""


class _Answer(msgspec.Struct, frozen=True):
    num_frames: int
    qpos_size: int
    start: bool = False


class _Question(msgspec.Struct, frozen=True):
    start: bool = False


class _Buttons(msgspec.Struct, frozen=True):
    right_key_one: bool = False
    left_key_one: bool = False


class _Told(msgspec.Struct, frozen=True):
    controller_buttons: _Buttons


class Pose(NamedTuple):
    """An answer.

    Attributes:
        is_start: Whether it answers the question that begins.
        qpos: Place [m] and orientation (wxyz) of the root, joints in Unitree's order [rad], shape (36,); the newest.
    """

    is_start: bool
    qpos: Floats


_ANSWERS, _TOLD = msgspec.json.Decoder(_Answer), msgspec.json.Decoder(_Told, strict=False)
_QUESTIONS = msgspec.json.Decoder(_Question)


def parse_pose(message: bytes) -> Pose:
    """Return what an answer says, whose parts are joined by a zero byte.

    Raises:
        BadPose: it is none.
    """
    head, _, numbers = message.partition(b"\0")
    try:
        answer = _ANSWERS.decode(head[:_MOST_TOLD])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadPose(f"its first part: {error}") from None
    if not 0 < answer.num_frames <= _MOST_FRAMES or answer.qpos_size != QPOS:
        raise BadPose(
            f"{answer.num_frames} frames of {answer.qpos_size} numbers, expected 1 to {_MOST_FRAMES} of {QPOS}"
        )
    if len(numbers) != 4 * answer.num_frames * QPOS:
        raise BadPose(f"{len(numbers)} bytes, expected {4 * answer.num_frames * QPOS}")
    qpos = np.frombuffer(numbers, "<f4")[-QPOS:].astype(np.float64)
    if not np.isfinite(qpos).all():
        raise BadPose("a number is not finite")
    if not 0.9 < float(np.linalg.norm(qpos[3:7])) < 1.1:
        raise BadPose(f"a quaternion of length {np.linalg.norm(qpos[3:7]):.3g}, expected 1")
    return Pose(answer.start, qpos)


def parse_buttons(data: bytes) -> tuple[bool, bool]:
    """Return whether the buttons to begin and to end are pressed.

    Raises:
        BadPose: bytes that say nothing of buttons.
    """
    try:
        told = _TOLD.decode(data[:_MOST_TOLD])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadPose(f"buttons: {error}") from None
    return told.controller_buttons.right_key_one, told.controller_buttons.left_key_one


def parse_question(data: bytes) -> bool:
    """Return whether a question begins.

    Raises:
        BadPose: bytes that ask for nothing.
    """
    try:
        return _QUESTIONS.decode(data[:_MOST_TOLD]).start
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadPose(f"a question: {error}") from None


def pack_pose(pose: Pose) -> tuple[bytes, bytes]:
    """Return the two parts of an answer of one frame."""
    head = msgspec.json.encode(_Answer(num_frames=1, qpos_size=len(pose.qpos), start=pose.is_start))
    return head, pose.qpos.astype("<f4").tobytes()


def pack_buttons(begins: bool, ends: bool, wall_ns: int) -> bytes:
    """Return whether the buttons to begin and to end are pressed, at an instant [ns since the epoch]."""
    buttons = _Buttons(right_key_one=begins, left_key_one=ends)
    return msgspec.json.encode({"t_ms": wall_ns // 1_000_000, "controller_buttons": buttons})


class Session:
    """When to ask, and which answer counts. Pure; its time is given.

    Attributes:
        state: ``waiting`` for the button, ``starting`` until the first answer, ``following``.
        asked_s: When the question was asked to which the next answer belongs [s]; None without one.
    """

    def __init__(self) -> None:
        self.state: State = "waiting"
        self.asked_s: float | None = None
        self._next_s = 0.0
        self._pressed = (True, True)  # a button that is held from before begins nothing

    def on_buttons(self, begins: bool, ends: bool) -> State:
        """Take up the buttons; return the state."""
        was_begins, was_ends = self._pressed
        self._pressed = begins, ends
        if ends and not was_ends:
            self.state, self.asked_s = "waiting", None
        elif begins and not was_begins:
            self.state, self.asked_s = "starting", None
        return self.state

    def due_s(self, now_s: float) -> float:
        """Return in how much time the next question may be due, at an instant [s]."""
        if self.state == "waiting":
            return math.inf
        return max(self._next_s - now_s, 0.0 if self.asked_s is None else self.asked_s + UNANSWERED_S - now_s, 0.0)

    def ask(self, now_s: float) -> bytes | None:
        """Return the question that is due at an instant [s], or None."""
        is_open = self.asked_s is not None and now_s - self.asked_s < UNANSWERED_S
        if self.state == "waiting" or is_open or now_s < self._next_s:
            return None
        self._next_s = max(self._next_s + ASK_S, now_s)
        self.asked_s = now_s
        return msgspec.json.encode({"start": self.state == "starting"})

    def on_answer(self, is_start: bool) -> str:
        """Take up an answer; return why it does not count, or ""."""
        if self.state == "waiting":
            return "nobody has begun, or it came after the end"
        if self.asked_s is None:
            return "nothing was asked"
        if is_start != (self.state == "starting"):
            return "it answers a question of before the beginning"
        self.state, self.asked_s = "following", None
        return ""


class PosedRobot:
    """From poses to TWIST2's command: velocities of the root are differences, from one question to the next."""

    def __init__(self) -> None:
        self._last: tuple[float, Floats] | None = None
        self._velocity: Floats = np.zeros(3)

    def command(self, qpos: Floats, asked_s: float) -> Floats:
        """Return the command that asks for a pose, shape (35,).

        Args:
            qpos: The pose, shape (36,).
            asked_s: When it was asked for [s].
        """
        quat = normalized(qpos[3:7])
        turn = np.zeros(3)
        last, self._last = self._last, (asked_s, qpos)
        if last is not None and 0.0 < (dt_s := asked_s - last[0]) < _LONGEST_STEP_S:
            moved = (qpos[:3] - last[1][:3]) / dt_s
            self._velocity = self._velocity + (moved - self._velocity) * min(1.0, dt_s / _SMOOTHED_S)
            turn = rotation_vector(multiply(inverse(normalized(last[1][3:7])), quat)) / dt_s
        else:
            self._velocity = np.zeros(3)
        linear = rotate_inverse(quat, self._velocity)
        return FORMAT.encode(Reference(qpos[:3], quat, linear, turn, qpos[7:]), G1_29)


class PoseServer:
    """Their three sockets, which we connect to; the server may come and go.

    Args:
        host: Where it is.
        ports: Of questions, answers and buttons.

    Attributes:
        bad: Messages that were none, by the reason.

    Raises:
        StationError: no pyzmq, or no such address.
    """

    def __init__(self, host: str, ports: tuple[int, int, int] = PORTS) -> None:
        zmq = self._zmq = zeromq.library()
        self.bad = Counter[str]()
        with contextlib.ExitStack() as undo:
            kinds = (zmq.PUSH, zmq.PULL, zmq.PULL)
            self._sockets = [undo.enter_context(contextlib.closing(zeromq.open_socket(zmq, kind))) for kind in kinds]
            self._asked, self._answers, self._buttons = self._sockets
            self._asked.setsockopt(zmq.SNDHWM, 1)
            self._asked.setsockopt(zmq.IMMEDIATE, 1)  # nothing waits for a server that is not there
            for socket, port in zip(self._sockets, ports, strict=True):
                socket.setsockopt(zmq.RCVHWM, _BACKLOG)
                address = f"tcp://{host}:{port}"
                with zeromq.explained(zmq, socket, address, "connected to"):
                    socket.connect(address)
            undo.pop_all()
        self._poller = zmq.Poller()
        for socket in (self._answers, self._buttons):
            self._poller.register(socket, zmq.POLLIN)

    def ask(self, question: bytes) -> bool:
        """Ask for a pose; return whether a server takes the question."""
        try:
            self._asked.send(question, self._zmq.NOBLOCK)
        except self._zmq.Again:
            return False
        return True

    def wait(self, timeout_s: float) -> None:
        """Wait until something has come, or for a time [s]."""
        self._poller.poll(round(timeout_s * 1e3))

    def answers(self) -> Iterator[bytes]:
        """Yield the answers that have come, their parts joined by a zero byte."""
        for parts in _come(self._zmq, self._answers):
            if len(parts) == 2:
                yield b"\0".join(parts)
            else:
                self.bad[f"{len(parts)} parts, expected 2"] += 1

    def buttons(self) -> Iterator[tuple[bool, bool]]:
        """Yield, for each message of their buttons, whether the one that begins and the one that ends are pressed."""
        for parts in _come(self._zmq, self._buttons):
            try:
                yield parse_buttons(b"".join(parts))
            except BadPose:
                self.bad["no buttons"] += 1

    def close(self) -> None:
        """Hang up."""
        for socket in self._sockets:
            socket.close()


class AskingRobot:
    """A robot of theirs, which connects to our three sockets and asks; it may come and go.

    Args:
        host: The one address of this computer on which we listen.
        ports: Of questions, answers and buttons.

    Attributes:
        bad: Messages that were no questions, by the reason.
        connected: A number for each connection that there is, as of the last `poll`; none comes twice, and more than
            one is one too many.

    Raises:
        StationError: no pyzmq, or it cannot listen there.
    """

    def __init__(self, host: str, ports: tuple[int, int, int] = PORTS) -> None:
        zmq = self._zmq = zeromq.library()
        self.bad, self.connected = Counter[str](), frozenset[int]()
        self._peers, self._numbers = dict[int, int](), itertools.count(1)
        with contextlib.ExitStack() as undo:
            kinds = (zmq.PULL, zmq.PUSH, zmq.PUSH)
            self._sockets = [undo.enter_context(contextlib.closing(zeromq.open_socket(zmq, kind))) for kind in kinds]
            self._questions, self._answers, self._buttons = self._sockets
            self._questions.setsockopt(zmq.RCVHWM, _BACKLOG)
            for socket in (self._answers, self._buttons):
                socket.setsockopt(zmq.SNDHWM, _QUEUED)
                socket.setsockopt(zmq.SNDBUF, _KERNEL_BYTES)
            self._news = self._buttons.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
            undo.callback(self._news.close)
            undo.callback(self._buttons.disable_monitor)
            for socket, port in zip(self._sockets, ports, strict=True):
                address = f"tcp://{host}:{port}"
                with zeromq.explained(zmq, socket, address, "listened on"):
                    socket.bind(address)
            undo.pop_all()

    def poll(self) -> None:
        """Update `connected`."""
        for parts in _come(self._zmq, self._news):
            event, peer = _EVENT.unpack_from(parts[0])
            if event == self._zmq.EVENT_ACCEPTED:
                self._peers[peer] = next(self._numbers)
            else:
                self._peers.pop(peer, None)
        self.connected = frozenset(self._peers.values())

    def wait(self, timeout_s: float) -> None:
        """Wait for a question, or for a time [s]."""
        self._questions.poll(round(timeout_s * 1e3))

    def question(self) -> bool | None:
        """Return whether what is asked begins, None where nothing is asked."""
        found: bool | None = None
        for parts in _come(self._zmq, self._questions):
            try:
                found = parse_question(b"".join(parts)) or bool(found)
            except BadPose:
                self.bad["no question"] += 1
        return found

    def answer(self, pose: Pose) -> bool:
        """Send an answer; return whether there was a robot with room for it."""
        return self._send(self._answers, pack_pose(pose))

    def press(self, *, begins: bool, ends: bool, wall_ns: int) -> None:
        """Send which of the two buttons are pressed, and when [ns since the epoch]; dropped where no robot reads."""
        self._send(self._buttons, (pack_buttons(begins, ends, wall_ns),))

    def close(self) -> None:
        """Stop listening; what was sent last is delivered if the robot reads it within 0.2 s."""
        self._buttons.disable_monitor()
        self._news.close()
        for socket in self._sockets:
            socket.close(linger=_LAST_WORD_MS)

    def _send(self, socket: Any, parts: tuple[bytes, ...]) -> bool:
        try:
            socket.send_multipart(parts, self._zmq.NOBLOCK)
        except self._zmq.Again:
            return False
        return True


_EVENT = struct.Struct("=Hi")
"""Of a monitor, in libzmq's version 1: which, and the connection's file descriptor."""


def _come(zmq: Any, socket: Any) -> Iterator[list[bytes]]:
    """Yield messages that have come, 16 at most: a peer that floods us must not keep us from other work."""
    for _ in range(_BACKLOG):
        try:
            yield socket.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return
