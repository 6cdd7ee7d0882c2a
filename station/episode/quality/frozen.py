"""A state that stands still though the robot moves: the whole of it written again and again, or a single joint stuck.

Frozen: the very same numbers in more than five writes in a row, while the gate lets commands through, and either the
frozen velocities say that a joint moves or the applied command had covered more than 0.05 rad five writes before the
last of them. A robot in simulation that stands still repeats its state exactly, until a command that has begun to move
reaches its joints.

Repeated: a state that is the one before once more, in a write of its own, while a velocity says that a joint moves. A
sensor that is read half as often as it is told repeats every second one.

Stuck: time is cut into windows of 0.5 s. In a row of them a joint covers less than 0.5 mrad, which is encoder noise,
while its applied command covers more than 0.1 rad and another joint does move. A joint at its end is not stuck: it is
asked to go further.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.episode.quality.finding_parts import FrozenState, Seen, StuckJoint
from station.episode.quality.motion import IDLE_BELOW_RAD
from station.episode.reading.messages import Ints
from station.protocols import Floats

MOST_EQUAL = 5
"""Writes in a row that may be equal: a sensor is slower than the loop that writes it."""

_MOVES_RAD_S = 0.1
_WINDOW_NS = 500_000_000
_STILL_RAD, _ASKED_RAD, _OTHERS_RAD = 5e-4, 0.1, 0.05
_AT_END_RAD = 0.02
_LEAST_WINDOWS = 2


class StepRows(NamedTuple):
    """Consecutive policy steps of one robot, k of them.

    Attributes:
        times: When their results were written, shape (k,) [ns since the epoch].
        writes: How many states had been written when the step was made, shape (k,).
        state: The whole state that each saw, shape (k, m).
        q, asked: Of the n joints that state and command share: measured, and applied or NaN where the gate let no
            command through or things may stop a joint, shape (k, n) [rad].
        speed: Of the joint that is fastest, as the state says, shape (k,) [rad/s]; 0 where it says nothing.
    """

    times: Ints
    writes: Ints
    state: Floats
    q: Floats
    asked: Floats
    speed: Floats


@dataclass
class _Run:
    """Steps in a row that saw equal states; `moved_write` is that at which the command had moved, -1 before."""

    first_ns: int
    last_ns: int
    first_write: int
    last_write: int
    speed: float
    low: Floats
    high: Floats
    moved_write: int = -1

    def joined(self, last_ns: int, asked: Floats, writes: Ints) -> _Run:
        """Return it with further steps: what was asked in each, shape (k, n), and the writes that it had seen."""
        low = np.fmin.accumulate(np.vstack([self.low, asked]))[1:]
        high = np.fmax.accumulate(np.vstack([self.high, asked]))[1:]
        moved_write = self.moved_write
        if moved_write < 0 and (moved := (high - low > IDLE_BELOW_RAD).any(axis=1)).any():  # NaN is no motion
            moved_write = int(writes[np.argmax(moved)])
        return replace(
            self, last_ns=last_ns, last_write=int(writes[-1]), low=low[-1], high=high[-1], moved_write=moved_write
        )

    @property
    def is_frozen(self) -> bool:
        if self.last_write - self.first_write < MOST_EQUAL:
            return False
        return self.speed > _MOVES_RAD_S or 0 <= self.moved_write <= self.last_write - MOST_EQUAL


class FrozenMeter:
    """Finds times in which the whole state was written again and again."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns
        self._last: Floats | None = None
        self._run: _Run | None = None
        self._seconds = 0.0
        self._longest: _Run | None = None
        self._writes = self._repeats = self._repeat_ns = 0
        self.moving = 0

    def take(self, rows: StepRows) -> None:
        """Add steps."""
        same = np.zeros(len(rows.times), dtype=np.bool_)
        same[1:] = (rows.state[1:] == rows.state[:-1]).all(axis=1)
        same[0] = self._last is not None and np.array_equal(self._last, rows.state[0])
        self._count_repeats(rows, same)
        starts = np.flatnonzero(~same)
        bounds = starts if len(starts) and starts[0] == 0 else np.concatenate([[0], starts])
        ends = np.append(bounds[1:], len(same)) - 1
        is_long = rows.writes[ends] - rows.writes[bounds] >= MOST_EQUAL
        is_long[[0, -1]] = True  # they may go on in another block
        for index in np.flatnonzero(is_long).tolist():
            self._add(rows, int(bounds[index]), int(ends[index]), goes_on=bool(same[bounds[index]]))
        self._last = rows.state[-1]

    def result(self) -> FrozenState | None:
        """Return what was frozen; None where nothing was."""
        self._close()
        if self._longest is None:
            return None
        run = self._longest
        return FrozenState(
            seconds=self._seconds,
            longest_s=(run.last_ns - run.first_ns) * 1e-9,
            at_s=round((run.first_ns - self._start_ns) * 1e-9, 3),
            writes=run.last_write - run.first_write + 1,
        )

    def repeats(self) -> Seen:
        """Return how many of the states that came while it moved are the one before once more."""
        first_s = round((self._repeat_ns - self._start_ns) * 1e-9, 3) if self._repeats else None
        return Seen(self._repeats, first_s)

    def _count_repeats(self, rows: StepRows, same: NDArray[np.bool_]) -> None:
        is_new = np.diff(rows.writes, prepend=self._writes) > 0
        self._writes = int(rows.writes[-1])
        moving = is_new & (rows.speed > _MOVES_RAD_S)
        self.moving += int(moving.sum())
        repeated = np.flatnonzero(moving & same)
        if len(repeated):
            self._repeat_ns = self._repeat_ns or int(rows.times[repeated[0]])
            self._repeats += len(repeated)

    def _add(self, rows: StepRows, begin: int, end: int, *, goes_on: bool) -> None:
        run = self._run
        if not goes_on or run is None:
            self._close()
            first_ns, first_write, none = int(rows.times[begin]), int(rows.writes[begin]), rows.asked[begin]
            run = _Run(first_ns, first_ns, first_write, first_write, float(rows.speed[begin]), none, none)
        within = slice(begin, end + 1)
        self._run = run.joined(int(rows.times[end]), rows.asked[within], rows.writes[within])

    def _close(self) -> None:
        run, self._run = self._run, None
        if run is None or not run.is_frozen:
            return
        self._seconds += (run.last_ns - run.first_ns) * 1e-9
        longest = self._longest
        if longest is None or run.last_ns - run.first_ns > longest.last_ns - longest.first_ns:
            self._longest = run


class StuckMeter:
    """Finds joints that stood still though they were asked to move.

    Args:
        start_ns: Instant that times are told from [ns since the epoch].
        joints: Names of the n joints of the rows.
        ends: Least and greatest position of each, shape (2, n) [rad]; NaN where unknown.
    """

    def __init__(self, start_ns: int, joints: list[str], ends: Floats) -> None:
        self._start_ns, self._joints, self._ends = start_ns, joints, ends
        self._windows: list[int] = []
        self._found: list[list[Floats]] = [[], [], [], []]  # least and greatest measured, then commanded

    def take(self, rows: StepRows) -> None:
        """Add steps."""
        if not self._joints:
            return
        numbers = (rows.times - self._start_ns) // _WINDOW_NS
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
        extremes = [make.reduceat(values, starts) for values in (rows.q, rows.asked) for make in (np.fmin, np.fmax)]
        first = 0
        if self._windows and self._windows[-1] == numbers[0]:  # a window that reaches across two blocks
            first = 1
            for place, make in enumerate((np.fmin, np.fmax) * 2):
                self._found[place][-1] = make(self._found[place][-1], extremes[place][0])
        self._windows += numbers[starts][first:].tolist()
        for place, values in enumerate(extremes):
            self._found[place].extend(values[first:])

    def result(self) -> list[StuckJoint]:
        """Return the joints that were stuck, the longest first."""
        if not self._windows:
            return []
        windows = np.array(self._windows)
        measured, asked = np.array(self._found[:2]), np.array(self._found[2:])
        still = measured[1] - measured[0] < _STILL_RAD
        found = []
        for joint in np.flatnonzero(still.any(axis=0)).tolist():
            runs = [
                stuck
                for begin, end in _runs(still[:, joint])
                if (stuck := self._stuck(joint, slice(begin, end), windows, measured, asked)) is not None
            ]
            if runs:
                found.append(max(runs, key=lambda each: each.seconds))
        return sorted(found, key=lambda each: -each.seconds)

    def _stuck(
        self, joint: int, span: slice, windows: NDArray[np.int64], measured: Floats, asked: Floats
    ) -> StuckJoint | None:
        covered = _covered(measured[:, span])
        wanted = _covered(asked[:, span])
        others = np.delete(covered, joint)
        where = measured[0, span, joint]
        near_end = (np.abs(self._ends[:, joint] - where[0]) < _AT_END_RAD).any()
        moves = len(others) and np.nanmax(others, initial=0.0) > _OTHERS_RAD
        if not (covered[joint] < _STILL_RAD and wanted[joint] > _ASKED_RAD and moves) or near_end:
            return None
        first, last = windows[span][0], windows[span][-1]
        return StuckJoint(
            joint=self._joints[joint],
            at_s=round(float(first * _WINDOW_NS * 1e-9), 3),
            seconds=float((last - first + 1) * _WINDOW_NS * 1e-9),
            position_rad=float(where[0]),
            asked_rad=float(wanted[joint]),
        )


def _runs(still: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and one past the last of each row of windows that is long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= _LEAST_WINDOWS]


def _covered(extremes: Floats) -> Floats:
    """Return by how much each joint moved, of least and greatest positions of windows, shape (2, k, n)."""
    return np.asarray(np.fmax.reduce(extremes[1], axis=0) - np.fmin.reduce(extremes[0], axis=0))
