"""How the joints of a robot moved: idle ends, jerk, and how often a joint reached its limit.

All three look at joint positions as they were published, in blocks, so an hour takes no more memory than a minute but
for one number per instant.

Idle: time is cut into windows of 0.5 s that begin every 0.1 s. In a window that is not idle a joint, commanded or
measured, covers more than 0.05 rad. Head and tail are what lies before the first and behind the last of those.

Jerk: `station.episode.quality.motion` has the formula.

At its end is a joint within 1 mrad of its limit, or beyond it.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from station.bus import keys
from station.description import Joint, RobotDescription
from station.episode.quality.blocks import Block, Blocks, Take
from station.episode.quality.finding_parts import MotionQuality
from station.episode.reading import steps
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.protocols import Floats

IDLE_BELOW_RAD = 0.05
IDLE_WINDOW_S = 0.5
AT_LIMIT_RAD = 1e-3

_BUCKET_NS = 100_000_000
_BUCKETS = round(IDLE_WINDOW_S * 1e9 / _BUCKET_NS)
_UNSURE_NS = (_BUCKETS - 1) * _BUCKET_NS
_JOINT = "_pos"

_JERK_S, _LEAST_POINTS, _MOST_POINTS = 0.12, 7, 101
_GAP = 1.5  # of the median interval


def moves(found: Iterable[MotionMeter]) -> list[tuple[int, int]]:
    """Return from when to when joints of any robot surely moved, in order [ns]."""
    together: list[tuple[int, int]] = []
    for begin, end in sorted(span for meter in found for span in meter.moves()):
        if together and begin <= together[-1][1]:
            together[-1] = together[-1][0], max(end, together[-1][1])
        else:
            together.append((begin, end))
    return together


def meters(reader: EpisodeReader) -> list[MotionMeter]:
    """Return a meter for each robot of an episode that tells of joints."""
    found = []
    for robot in sorted(steps.robots_of(reader)):
        state = steps.keys_of_joints(reader, robot, "state", (keys.robot_state,))
        command = steps.keys_of_joints(reader, robot, "command", (keys.command_used,))
        if state or command:
            first, asked = (next(iter(known), "") for known in (state, command))
            found.append(MotionMeter(robot, first, asked, reader.known.robot(robot)))
    return found


def moving_span(reader: EpisodeReader, robot: str) -> tuple[int, int] | None:
    """Return from when to when joints of a robot moved, what lies before and behind being the idle head and tail.

    Returns:
        Both instants [ns since the epoch], 0 where nothing ever moved; None where nothing tells of its joints.
    """
    meter = next((one for one in meters(reader) if one.robot == robot), None)
    if meter is None:
        return None
    blocks = {key: Blocks(take) for key, take in meter.takes().items()}
    for message in reader.messages(blocks):
        blocks[message.topic].feed(message)
    for one in blocks.values():
        one.flush()
    return meter.moved_ns()


class MotionMeter:
    """Takes the blocks of a robot's state and command, and tells at the end how its joints moved.

    Args:
        robot: Suffix of its keys.
        state_key, command_key: The keys; "" for one that there is not.
        description: Says where its joints end; None where nothing does.

    Attributes:
        robot: Suffix of its keys.
    """

    def __init__(
        self, robot: str, state_key: str, command_key: str, description: RobotDescription | None = None
    ) -> None:
        self.robot, self._state_key, self._command_key = robot, state_key, command_key
        self._is_carried = description is not None and description.is_carried
        self._stillness = [Stillness(), Stillness()]
        self._jerk, self._command_jerk, self._ends = Jerk(), Jerk(), Ends(description)
        self._sides = {state_key: self._add_state, command_key: self._add_command}

    def takes(self) -> dict[str, Take]:
        """Return what takes the blocks of each key that is wanted."""
        return {key: take for key, take in self._sides.items() if key}

    def moved_ns(self) -> tuple[int, int] | None:
        """Return when a joint moved first and last [ns since the epoch], 0 where none ever did; None without joints."""
        if all(one.first_ns is None for one in self._stillness):
            return None
        moved = [(one.moved_ns, one.rested_ns) for one in self._stillness if one.moved_ns is not None]
        return min((first for first, _ in moved), default=0), max((last for _, last in moved), default=0)

    def result(self) -> MotionQuality | None:
        """Return how the joints moved; None where no message held any."""
        moved = [one for one in self._stillness if one.first_ns is not None]
        if not moved:
            return None
        head_s, tail_s = _idle(moved)
        p99, most, worst = self._jerk.result()
        command_p99, _, command_worst = self._command_jerk.result()
        return MotionQuality(
            robot=self.robot,
            state_key=self._state_key,
            command_key=self._command_key,
            samples=self._ends.samples,
            idle_head_s=head_s,
            idle_tail_s=tail_s,
            idle_below_rad=IDLE_BELOW_RAD,
            idle_window_s=IDLE_WINDOW_S,
            jerk_p99_rad_s3=p99,
            jerk_max_rad_s3=most,
            worst_jerk_joint=worst,
            command_jerk_p99_rad_s3=command_p99,
            command_worst_jerk_joint=command_worst,
            is_carried=self._is_carried,
            limits_from=self._ends.said_by,
            limit_hits=self._ends.hits,
            limit_share=max(self._ends.shares().values(), default=0.0),
            limit_joints=self._ends.shares(),
            beyond_limit_rad=self._ends.beyond_rad,
        )

    def moves(self) -> list[tuple[int, int]]:
        """Return from when to when measured joints surely moved [ns].

        What was in motion may have begun as late as in the last part of the first window, and ended as early as in the
        first part of the last: the rest of either is left out.
        """
        found = self._stillness[0].moves_ns
        return [(begin + _UNSURE_NS, end - _UNSURE_NS) for begin, end in found if end - begin > 2 * _UNSURE_NS]

    def _add_state(self, block: Block) -> None:
        times, joints, q = _positions(block)
        if not q.size:
            return
        self._stillness[0].feed(times, q)
        self._jerk.feed(times, joints, q)
        self._ends.feed(joints, q)

    def _add_command(self, block: Block) -> None:
        times, joints, q = _positions(block)
        if not q.size:
            return
        self._stillness[1].feed(times, q)
        self._command_jerk.feed(times, joints, q)


def _positions(block: Block) -> tuple[Ints, tuple[str, ...], Floats]:
    """Return times (k,) [ns], and names and positions (k, n) [rad] of the joints in a block."""
    pairs = [
        (element.name.removesuffix(_JOINT), column)
        for column, element in enumerate(block.contract.elements)
        if element.name.endswith(_JOINT) and element.unit == "rad"
    ]
    return block.times, tuple(name for name, _ in pairs), block.values[:, [column for _, column in pairs]]


def ends_of(robot: RobotDescription | None, joints: Sequence[str]) -> Floats:
    """Return least and greatest position of joints, shape (2, n) [rad], nan where one is not known."""
    known = {joint.name: joint for joint in robot.joints} if robot is not None else {}
    found = [known.get(name, Joint(name)) for name in joints]
    ends = [[joint.lower for joint in found], [joint.upper for joint in found]]
    return np.array([[np.nan if end is None else end for end in side] for side in ends]).reshape(2, len(found))


class Stillness:
    """When joints moved first and last.

    Attributes:
        first_ns, last_ns: First and last instant that was told of; None before one.
        moved_ns, rested_ns: Beginning of the first window in which something moved, and end of the last; None for none.
        moves_ns: From when to when windows follow each other in which something moved.
    """

    def __init__(self) -> None:
        self.first_ns: int | None = None
        self.last_ns = 0
        self.moved_ns: int | None = None
        self.rested_ns = 0
        self.moves_ns: list[tuple[int, int]] = []
        self._buckets: list[tuple[int, Floats, Floats]] = []  # number, least and greatest position of each joint

    def feed(self, times: Ints, q: Floats) -> None:
        """Add positions (k, n) [rad] at times (k,) [ns]."""
        whole = np.isfinite(q).all(axis=1)
        times, q = times[whole], q[whole]
        if not len(times):
            return
        if self.first_ns is None:
            self.first_ns = int(times.min())
        self.last_ns = max(self.last_ns, int(times.max()))
        numbers_ = (times - self.first_ns) // _BUCKET_NS
        starts = np.flatnonzero(np.diff(numbers_, prepend=numbers_[0] - 1))
        least, most = np.minimum.reduceat(q, starts), np.maximum.reduceat(q, starts)
        for number, low, high in zip(numbers_[starts].tolist(), least, most, strict=True):
            self._bucket(number, low, high)

    def _bucket(self, number: int, low: Floats, high: Floats) -> None:
        assert self.first_ns is not None
        self._buckets = [one for one in self._buckets if number - one[0] < _BUCKETS and len(one[1]) == len(low)]
        self._buckets.append((number, low, high))
        least = np.min([one[1] for one in self._buckets], axis=0)
        most = np.max([one[2] for one in self._buckets], axis=0)
        if (most > least + IDLE_BELOW_RAD).any():
            self._add_move(self.first_ns + self._buckets[0][0] * _BUCKET_NS, self.first_ns + (number + 1) * _BUCKET_NS)
            if self.moved_ns is None:
                self.moved_ns = self.first_ns + self._buckets[0][0] * _BUCKET_NS
            self.rested_ns = min(self.first_ns + (number + 1) * _BUCKET_NS, self.last_ns)

    def _add_move(self, from_ns: int, to_ns: int) -> None:
        if self.moves_ns and from_ns <= self.moves_ns[-1][1]:
            from_ns = self.moves_ns.pop()[0]
        self.moves_ns.append((from_ns, to_ns))


def _idle(sides: list[Stillness]) -> tuple[float, float]:
    """Return how long all sides were still at the beginning and at the end [s]."""
    begin, end = min(side.first_ns or 0 for side in sides), max(side.last_ns for side in sides)
    moved = [side.moved_ns for side in sides if side.moved_ns is not None]
    if not moved:
        return (end - begin) * 1e-9, 0.0
    rested = max(side.rested_ns for side in sides if side.moved_ns is not None)
    return (min(moved) - begin) * 1e-9, max(0, end - rested) * 1e-9


class Ends:
    """How often and how long joints were at their ends.

    Attributes:
        samples: Positions that were looked at.
        hits: How often a joint reached its limit.
        beyond_rad: How far beyond its end a joint was at most; None where nothing says where joints end.
    """

    def __init__(self, description: RobotDescription | None) -> None:
        self._description = description
        self._joints: tuple[str, ...] = ()
        self._limits: Floats | None = None
        self._counts: NDArray[np.int64] = np.empty(0, np.int64)
        self._was: NDArray[np.bool_] = np.empty(0, np.bool_)
        self.samples = self.hits = 0
        self.beyond_rad: float | None = None

    @property
    def said_by(self) -> str:
        """What says where the joints end."""
        return f"description of {self._description.model}" if self._limits is not None and self._description else ""

    def feed(self, joints: tuple[str, ...], q: Floats) -> None:
        """Add positions (k, n) [rad]."""
        if not self._joints:
            ends = ends_of(self._description, joints)
            self._joints, self._limits = joints, ends if np.isfinite(ends).any() else None
            self._counts, self._was = np.zeros(len(joints), np.int64), np.zeros(len(joints), np.bool_)
        self.samples += len(q)
        if self._limits is None or joints != self._joints:
            return
        lower, upper = self._limits
        beyond = np.maximum(lower - q, q - upper)
        at = beyond > -AT_LIMIT_RAD  # what is no number is at no end
        self._counts += at.sum(axis=0)
        self.hits += int((at & ~np.concatenate([self._was[None], at[:-1]])).sum())
        self._was = at[-1]
        known = beyond[np.isfinite(beyond)]
        if len(known):
            self.beyond_rad = max(float(known.max()), -np.inf if self.beyond_rad is None else self.beyond_rad)

    def shares(self) -> dict[str, float]:
        """Return the share of time at its end for each joint that ever was, the longest first."""
        pairs = zip(self._joints, self._counts.tolist(), strict=True)
        found = {joint: count / self.samples for joint, count in pairs if count}
        return dict(sorted(found.items(), key=lambda item: -item[1]))


class Jerk:
    """The greatest jerk of any joint, for each instant: of the cubic that fits 7 neighbouring positions best.

    That is Savitzky-Golay's way. Their time is taken as even: 6 c3 / dt^3 with dt the mean interval of the seven (or of
    as many as span 0.12 s). So a time stamp that is a millisecond off says nothing, and a quantum of 0.1 mrad
    1.5 rad/s^3; a walk has thousands. Where neighbours have a gap between them (1.5 times the median interval) none is.
    """

    def __init__(self) -> None:
        self._tail: tuple[Ints, Floats] | None = None
        self._weights: Floats = np.empty(0)
        self._greatest = array("d")
        self._most, self._joint = 0.0, ""

    def feed(self, times: Ints, joints: tuple[str, ...], q: Floats) -> None:
        """Add positions (k, n) [rad] at times (k,) [ns]."""
        if self._tail is not None and self._tail[1].shape[1] == q.shape[1]:
            times, q = np.concatenate([self._tail[0], times]), np.concatenate([self._tail[1], q])
        intervals = np.diff(times) * 1e-9
        if not len(intervals) or (median := float(np.median(intervals))) <= 0:
            return
        if not len(self._weights):
            self._weights = _third_derivative(round(_JERK_S / median) + 1)
        points = len(self._weights)
        self._tail = times[-(points - 1) :], q[-(points - 1) :]
        if len(times) < points:
            return
        spans = sliding_window_view(intervals, points - 1)
        fits = (spans.max(axis=1) <= _GAP * median) & (spans.min(axis=1) > 0)
        with np.errstate(all="ignore"):  # of numbers that no robot writes nothing finite comes, and it is left out
            jerk = np.abs(sliding_window_view(q, points, axis=0) @ self._weights) / spans.mean(axis=1)[:, None] ** 3
        self._add(jerk[fits & np.isfinite(jerk).all(axis=1)], joints)

    def _add(self, jerk: Floats, joints: tuple[str, ...]) -> None:
        if not len(jerk):
            return
        greatest = jerk.max(axis=1)
        self._greatest.frombytes(greatest.tobytes())
        top = int(greatest.argmax())
        if greatest[top] > self._most:
            self._most, self._joint = float(greatest[top]), joints[int(jerk[top].argmax())]

    def result(self) -> tuple[float | None, float | None, str]:
        """Return 99th percentile and greatest [rad/s^3], and the joint of the greatest."""
        if not len(self._greatest):
            return None, None, ""
        return float(np.percentile(np.frombuffer(self._greatest), 99)), self._most, self._joint


def _third_derivative(points: int) -> Floats:
    """Return the weights that make of evenly spaced values the third derivative of their best cubic, times dt^3."""
    points = min(max(points, _LEAST_POINTS), _MOST_POINTS) // 2 * 2 + 1
    places = np.arange(points) - points // 2
    return np.asarray(6.0 * np.linalg.pinv(np.vander(places, 4, increasing=True))[3])
