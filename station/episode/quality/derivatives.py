"""Whether the rates that a state holds are those of its positions: velocities of joints, and the gyro.

Over spans of about 60 ms (a sample at least) the change of a position is held against the mean of the recorded rate.
Agreement is the sum of their products over the roots of both sums of squares, 1 at best: a unit does not change it, and
a time stamp that is a millisecond off hardly. A joint counts where its squared speed, summed over time, is more than
0.086 rad^2/s, an axis of the orientation above 0.01: what stands still says nothing. The scale is the sum of products
over the squares of the derivative: 57 where rates are in degrees, 0 where they are zeros.

The rotation between two orientations, in the body's own frame, is what its gyro measures. Quaternions in another order,
of another frame, or inverted turn otherwise. Moments in which the orientation turns slower than 0.05 rad/s are left
out: a gyro has noise, an estimated orientation hardly. Each axis is told by itself, so that a fast turn about one does
not hide that the two others are exchanged.

A position that goes further from one state to the next than 0.1 rad and twice what either velocity explains has jumped:
an encoder slipped, or the states are another's from there on. Nothing is told of a joint that moves otherwise than its
velocities say, nor across a gap.

In lock-step a machine takes its time, so an interval is what the contract says, not what the clock does.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from station import rotations
from station.bus.robot_streams import GYRO, QUAT
from station.episode.quality.blocks import SIZE, Block
from station.episode.quality.finding_parts import PositionJump
from station.episode.reading.messages import Ints
from station.protocols import Floats

_SPAN_S = 0.06
_GAP = 1.5  # intervals, by which a span may be longer than usual
_LEAST_MOTION = 2.5 / 29  # [rad^2/s], of a joint, as of `station.episode.quality.alignment`
_LEAST_TURNING = 0.01  # [rad^2/s], of an axis
_TURNS_RAD_S = 0.05  # moments in which it turns slower are left out
_JUMP_RAD, _EXPLAINED = 0.1, 2.0
_MOST_JUMPS = 1000  # that are kept; noise makes one of every state
_LIKE = 0.8  # agreement with another joint's velocity that is named
_POSITION, _VELOCITY = "_pos", "_vel"


class DerivativeMeter:
    """Takes the blocks of a robot's state.

    Args:
        names: Of its elements; blocks with others are passed over.
        start_ns: Instant that times are told from [ns since the epoch].
        period_s: Time from state to state where clocks do not say it, in lock-step [s]; None where they do.
    """

    def __init__(self, names: tuple[str, ...], start_ns: int, period_s: float | None = None) -> None:
        self._names, self._start_ns, self._period_s = names, start_ns, period_s
        columns = {name: column for column, name in enumerate(names)}
        joints = [name.removesuffix(_POSITION) for name in names if name.endswith(_POSITION)]
        self._joints = [joint for joint in joints if joint + _VELOCITY in columns]
        self._q = [columns[joint + _POSITION] for joint in self._joints]
        self._v = [columns[joint + _VELOCITY] for joint in self._joints]
        has_both = all(name in columns for name in (*QUAT, *GYRO))
        self._quat, self._gyro = ([columns[name] for name in group] if has_both else [] for group in (QUAT, GYRO))
        self._stride, self._interval_s = 0, 0.0
        self._tail: Block | None = None
        count = len(self._joints)
        self._derived, self._told, self._both = np.zeros(count), np.zeros(count), np.zeros((count, count))
        self._turned, self._measured, self._along = np.zeros(3), np.zeros(3), np.zeros((3, 3))  # likewise, by axis
        self._jumps: list[tuple[int, int, float, int]] = []  # when [ns], which joint, by how much, how many with it

    def take(self, block: Block) -> None:
        """Add a block."""
        if block.contract.names != self._names or not (self._q or self._quat):
            return
        times, values, first = block.times, block.values, 0
        if self._tail is not None:
            first = len(self._tail.times) - 1
            times, values = np.concatenate([self._tail.times, times]), np.concatenate([self._tail.values, values])
        intervals = np.diff(times) * 1e-9
        if not self._stride and len(intervals) and (interval_s := self._period_s or float(np.median(intervals))) > 0:
            self._stride, self._interval_s = max(1, round(_SPAN_S / interval_s)), interval_s
        if not self._stride or len(times) <= self._stride:
            self._tail = block._replace(times=times[-SIZE:], values=values[-SIZE:])
            return
        self._tail = block._replace(times=times[-self._stride :], values=values[-self._stride :])
        spans = (times[self._stride :] - times[: -self._stride]) * 1e-9
        fits = spans > 0
        if self._period_s is None:
            fits &= spans < (self._stride + _GAP) * self._interval_s
        with np.errstate(all="ignore"):  # of numbers that no robot writes nothing finite comes, and it is left out
            self._add_joints(values, fits, self._jumped(times, values, intervals, first))
            self._add_turning(values, fits)

    def velocities(self) -> tuple[dict[str, float], dict[str, str], float | None]:
        """Return how far the velocity of each joint that moved agrees with its positions; whose it agrees with instead.

        And the median over these joints of velocity to derivative, where they agree; None where none does, 0 where all
        velocities are zeros though joints moved.
        """
        moves = self._derived * self._interval_s > _LEAST_MOTION
        if moves.any() and not self._told.any():
            return {}, {}, 0.0
        moved = moves & (self._told > 0)
        with np.errstate(all="ignore"):
            agreement = self._both / np.sqrt(np.outer(self._derived, self._told))
            factors = np.diag(self._both) / self._derived
        own = {self._joints[index]: float(agreement[index, index]) for index in np.flatnonzero(moved)}
        like = {}
        for index in np.flatnonzero(moved):
            row = np.where(moved, agreement[index], -1.0)
            best = int(row.argmax())
            if row[best] > _LIKE >= agreement[best, best]:  # exchanged: the other one's positions need another, too
                like[self._joints[index]] = self._joints[best]
        agree = [factors[index] for index in np.flatnonzero(moved) if agreement[index, index] > _LIKE]
        return own, like, float(np.median(agree)) if agree else None

    def orientation(self) -> tuple[dict[str, float], float | None]:
        """Return how far each axis of the gyro agrees with the orientation, up to 1, of those about which that turned.

        And the scale of the gyro, over these axes: 0 where it is zero; None where too little turned, or nothing agrees.
        """
        turned = self._turned * self._interval_s > _LEAST_TURNING
        if turned.any() and not self._measured.any():
            return {}, 0.0
        turned &= self._measured * self._interval_s > 0
        with np.errstate(all="ignore"):
            agreement = np.diag(self._along) / np.sqrt(self._turned * self._measured)
        found = {GYRO[axis]: float(agreement[axis]) for axis in np.flatnonzero(turned)}
        agrees = turned & (agreement > _LIKE)
        scale = float(np.diag(self._along)[agrees].sum() / self._turned[agrees].sum()) if agrees.any() else None
        return found, scale

    def jumps(self) -> list[PositionJump]:
        """Return by joint where positions went further than velocities explain, in the order of the first of each."""
        with np.errstate(all="ignore"):
            agrees = np.diag(self._both) > _LIKE * np.sqrt(self._derived * self._told)
        rests = self._derived * self._interval_s <= _LEAST_MOTION
        told = (agrees | rests) & self._told.any()
        found: dict[int, list[tuple[int, float, int]]] = {}
        for at_ns, joint, by_rad, joints in self._jumps:
            if told[joint]:
                found.setdefault(joint, []).append((at_ns, by_rad, joints))
        return [
            PositionJump(
                joint=self._joints[joint],
                at_s=round((each[0][0] - self._start_ns) * 1e-9, 3),
                by_rad=each[0][1],
                count=len(each),
                joints=each[0][2],
            )
            for joint, each in found.items()
        ]

    def _add_joints(self, values: Floats, fits: NDArray[np.bool_], jumped: NDArray[np.bool_]) -> None:
        if not self._q:
            return
        q, told = values[:, self._q], self._means(values[:, self._v])
        derived = (q[self._stride :] - q[: -self._stride]) / (self._stride * self._interval_s)
        if jumped.any():  # what jumped tells nothing of velocities
            within = sliding_window_view(jumped, self._stride, axis=0).any(axis=-1)
            derived, told = np.where(within, 0.0, derived), np.where(within, 0.0, told)
        good = fits & np.isfinite(derived).all(axis=1) & np.isfinite(told).all(axis=1)
        derived, told = derived[good], told[good]
        self._derived += (derived**2).sum(axis=0)
        self._told += (told**2).sum(axis=0)
        self._both += derived.T @ told

    def _jumped(self, times: Ints, values: Floats, intervals: Floats, first: int) -> NDArray[np.bool_]:
        """Return which joints jumped between which states, shape (k - 1, n); those from a row on are new."""
        speed = np.abs(values[:, self._v])
        explained = np.maximum(speed[1:], speed[:-1]) * (_EXPLAINED * self._interval_s) + _JUMP_RAD
        step = np.diff(values[:, self._q], axis=0)
        jumped = (np.abs(step) > explained) & np.isfinite(step) & (np.abs(step) < np.inf)
        if self._period_s is None:
            jumped &= (intervals < _GAP * self._interval_s)[:, None]
        for new, joint in np.argwhere(jumped[first:])[: _MOST_JUMPS - len(self._jumps)]:
            row = first + new
            by_rad, joints = float(step[row, joint]), int(jumped[row].sum())
            self._jumps.append((int(times[row + 1]), int(joint), by_rad, joints))
        return np.asarray(jumped)

    def _add_turning(self, values: Floats, fits: NDArray[np.bool_]) -> None:
        if not self._quat:
            return
        quat, measured = rotations.normalized(values[:, self._quat]), self._means(values[:, self._gyro])
        step = rotations.multiply(rotations.inverse(quat[: -self._stride]), quat[self._stride :])
        turned = rotations.rotation_vector(step) / (self._stride * self._interval_s)
        turns = (turned**2).sum(axis=1) > _TURNS_RAD_S**2
        good = fits & turns & np.isfinite(turned).all(axis=1) & np.isfinite(measured).all(axis=1)
        turned, measured = turned[good], measured[good]
        self._turned += (turned**2).sum(axis=0)
        self._measured += (measured**2).sum(axis=0)
        self._along += turned.T @ measured

    def _means(self, rates: Floats) -> Floats:
        """Return the mean of rates over each span, by trapezoids."""
        return np.asarray(sliding_window_view((rates[1:] + rates[:-1]) / 2, self._stride, axis=0).mean(axis=-1))
