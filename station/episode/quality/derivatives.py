"""Whether the rates that a state holds are those of its positions: velocities of joints, and the gyro.

Over spans of about 60 ms (a sample at least) the change of a position is held against the mean of the recorded rate.
Agreement is the sum of their products over the roots of both sums of squares, 1 at best: a unit does not change it, and
a time stamp that is a millisecond off hardly. A joint counts where its squared speed, summed over time, is more than
0.086 rad^2/s, an orientation above 0.3: what stands still says nothing. A robot without rates writes zeros, and
nothing is told of them.

The rotation between two orientations, in the body's own frame, is what its gyro measures. Quaternions in another order,
of another frame, or inverted turn otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from station import rotations
from station.bus.robot_streams import GYRO, QUAT
from station.episode.quality.blocks import SIZE, Block
from station.protocols import Floats

_SPAN_S = 0.06
_GAP = 1.5  # intervals, by which a span may be longer than usual
_LEAST_MOTION = 2.5 / 29  # [rad^2/s], of a joint, as of `station.episode.quality.alignment`
_LEAST_TURNING = 0.3  # [rad^2/s]
_TURNS_RAD_S = 0.1  # moments in which it turns slower are left out
_LIKE = 0.8  # agreement with another joint's velocity that is named
_POSITION, _VELOCITY = "_pos", "_vel"


class DerivativeMeter:
    """Takes the blocks of a robot's state.

    Args:
        names: Of its elements; blocks with others are passed over.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
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
        self._turned = np.zeros(3)  # sums of squares of both, and of their products

    def take(self, block: Block) -> None:
        """Add a block."""
        if block.contract.names != self._names or not (self._q or self._quat):
            return
        times, values = block.times, block.values
        if self._tail is not None:
            times, values = np.concatenate([self._tail.times, times]), np.concatenate([self._tail.values, values])
        intervals = np.diff(times) * 1e-9
        if not self._stride and len(intervals) and (interval_s := float(np.median(intervals))) > 0:
            self._stride, self._interval_s = max(1, round(_SPAN_S / interval_s)), interval_s
        if not self._stride or len(times) <= self._stride:
            self._tail = block._replace(times=times[-SIZE:], values=values[-SIZE:])
            return
        self._tail = block._replace(times=times[-self._stride :], values=values[-self._stride :])
        spans = (times[self._stride :] - times[: -self._stride]) * 1e-9
        fits = (spans > 0) & (spans < (self._stride + _GAP) * self._interval_s)
        with np.errstate(all="ignore"):  # of numbers that no robot writes nothing finite comes, and it is left out
            self._add_joints(values, fits)
            self._add_turning(values, fits)

    def velocities(self) -> tuple[dict[str, float], dict[str, str], float | None]:
        """Return how far the velocity of each joint that moved agrees with its positions; whose it agrees with instead.

        And the median over these joints of velocity to derivative, where they agree; None where none does.
        """
        moved = (self._derived * self._interval_s > _LEAST_MOTION) & (self._told > 0)
        with np.errstate(all="ignore"):
            agreement = self._both / np.sqrt(np.outer(self._derived, self._told))
            factors = np.diag(self._both) / self._derived
        own = {self._joints[index]: float(agreement[index, index]) for index in np.flatnonzero(moved)}
        like = {}
        for index in np.flatnonzero(moved):
            row = np.where(moved, agreement[index], -1.0)
            best = int(row.argmax())
            if best != index and row[best] > _LIKE:
                like[self._joints[index]] = self._joints[best]
        agree = [factors[index] for index in np.flatnonzero(moved) if agreement[index, index] > _LIKE]
        return own, like, float(np.median(agree)) if agree else None

    def orientation(self) -> float | None:
        """Return how far the gyro agrees with the turning of the orientation, up to 1; None where too little turned."""
        turned, measured, both = self._turned
        if not (min(turned, measured) * self._interval_s > _LEAST_TURNING):
            return None
        return float(both / np.sqrt(turned * measured))

    def _add_joints(self, values: Floats, fits: NDArray[np.bool_]) -> None:
        if not self._q:
            return
        q, told = values[:, self._q], self._means(values[:, self._v])
        derived = (q[self._stride :] - q[: -self._stride]) / (self._stride * self._interval_s)
        good = fits & np.isfinite(derived).all(axis=1) & np.isfinite(told).all(axis=1)
        derived, told = derived[good], told[good]
        self._derived += (derived**2).sum(axis=0)
        self._told += (told**2).sum(axis=0)
        self._both += derived.T @ told

    def _add_turning(self, values: Floats, fits: NDArray[np.bool_]) -> None:
        if not self._quat:
            return
        quat, measured = rotations.normalized(values[:, self._quat]), self._means(values[:, self._gyro])
        step = rotations.multiply(rotations.inverse(quat[: -self._stride]), quat[self._stride :])
        turned = rotations.rotation_vector(step) / (self._stride * self._interval_s)
        turns = np.maximum((turned**2).sum(axis=1), (measured**2).sum(axis=1)) > _TURNS_RAD_S**2
        good = fits & turns & np.isfinite(turned).all(axis=1) & np.isfinite(measured).all(axis=1)
        turned, measured = turned[good], measured[good]
        self._turned += (turned**2).sum(), (measured**2).sum(), (turned * measured).sum()

    def _means(self, rates: Floats) -> Floats:
        """Return the mean of rates over each span, by trapezoids."""
        return np.asarray(sliding_window_view((rates[1:] + rates[:-1]) / 2, self._stride, axis=0).mean(axis=-1))
