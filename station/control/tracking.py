"""How well a robot follows: one definition for rehearsals, the check of an episode, its plots and its report.

A tick counts while the motion plays (not while it blends in, pauses or leaves) and the gate tracks. The error of a
joint is the mean over these ticks of |q - commanded q|, where q was measured at the start of the tick and the command
is the one that the policy got in that tick; the error of a run is the mean over its joints and ticks. What is no number
was not measured, and does not count. Height: |z - commanded z| of the root, where the robot knows its z.

Of a command that names ``vx``, ``vy``, ``wz`` the velocity of the base is compared, where the robot knows its place:
its way from one of these ticks to the next over the control period, in the frame of its heading, and how far that
turned. A gait sways, so means are compared: over a second each for the error, and over each stretch of one command from
1.5 s after it began.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.protocols import LARGEST_JOINT_ERROR_RAD, Floats
from station.rotations import roll_pitch_yaw

VELOCITIES = ("vx", "vy", "wz")
"""Elements of a command that are velocities of the base in the frame of its heading [m/s, m/s, rad/s]."""

WINDOW_S = 1.0
"""Velocities are compared as means over so long [s]: a stride or two."""

SETTLES_S, SHORTEST_S = 1.5, 3.0
"""A stretch of one command is measured from so long after it began, and if it lasts so long [s]."""

MOST_STRETCHES = 60
"""Of an episode, the longest."""


class TrackingError:
    """Accumulates the errors of a run.

    Args:
        names: Of the command's elements.
        joint_names: Joints of the robot, in the order of `q`.
    """

    def __init__(self, names: tuple[str, ...], joint_names: tuple[str, ...]) -> None:
        self._names = tuple(name for name in joint_names if f"{name}_pos" in names)
        self._joints = np.array([joint_names.index(name) for name in self._names], dtype=np.intp)
        self._elements = np.array([names.index(f"{name}_pos") for name in self._names], dtype=np.intp)
        self._height = names.index("root_height") if "root_height" in names else None
        self._sums, self._counts = np.zeros(len(self._names)), np.zeros(len(self._names), dtype=np.int64)
        self._height_sum, self._height_ticks = 0.0, 0
        self.ticks = 0

    def add(self, q: Floats, command: Floats, root_height_m: float | None = None) -> None:
        """Add a tick that counts: joints [rad], command vector, height of the root [m] where known."""
        self.ticks += 1
        with np.errstate(all="ignore"):
            errors = np.abs(q[self._joints] - command[self._elements])
        known = errors <= LARGEST_JOINT_ERROR_RAD
        self._sums += np.where(known, errors, 0.0)
        self._counts += known
        if root_height_m is not None and self._height is not None and math.isfinite(command[self._height]):
            self._height_sum += abs(root_height_m - float(command[self._height]))
            self._height_ticks += 1

    @property
    def mean_joint_error_rad(self) -> float | None:
        """Mean joint error [rad]; None when no tick counted, or no joint is commanded."""
        count = int(self._counts.sum())
        return float(self._sums.sum()) / count if count else None

    @property
    def joint_errors_rad(self) -> dict[str, float]:
        """Mean error of each joint that was compared [rad]."""
        measured = zip(self._names, self._sums.tolist(), self._counts.tolist(), strict=True)
        return {name: total / count for name, total, count in measured if count}

    @property
    def mean_root_height_error_m(self) -> float | None:
        """Mean height error [m]; None when no tick counted, or no height is commanded."""
        return self._height_sum / self._height_ticks if self._height_ticks else None


class VelocityStretch(msgspec.Struct, frozen=True):
    """A stretch of time in which one velocity was commanded.

    Attributes:
        at_s, seconds: When it began, and how long it lasted [s].
        commanded, measured: vx, vy [m/s], wz [rad/s].
    """

    at_s: float
    seconds: float
    commanded: tuple[float, float, float]
    measured: tuple[float, float, float]

    @property
    def in_short(self) -> str:
        """What was commanded and measured, in words."""
        asked, came = ("  ".join(f"{value:+z.2f}" for value in each) for each in (self.commanded, self.measured))
        return f"{self.seconds:4.1f} s: vx vy wz commanded {asked}, measured {came}"


class VelocityFound(msgspec.Struct, frozen=True):
    """How well a robot followed velocities.

    Attributes:
        error: Mean error of vx, vy [m/s], wz [rad/s], as means over a second.
        stretches: Each with one command, in order.
    """

    error: tuple[float, float, float]
    stretches: tuple[VelocityStretch, ...] = ()

    @property
    def in_short(self) -> str:
        """The error in words."""
        vx, vy, wz = self.error
        return f"mean velocity error vx {vx:.3f} m/s, vy {vy:.3f} m/s, wz {wz:.3f} rad/s (means over {WINDOW_S:g} s)"

    def lines(self) -> Iterator[str]:
        """Yield what a person reads: the error, then each stretch."""
        yield self.in_short
        yield from (f"  from {found.at_s:5.1f} s, {found.in_short}" for found in self.stretches)


class VelocityTracking:
    """Accumulates commanded and measured velocities of a run.

    Args:
        names: Of the command's elements.
        period_s: Control period [s].
    """

    def __init__(self, names: tuple[str, ...], period_s: float) -> None:
        is_asked = set(VELOCITIES) <= set(names)
        self._elements = [names.index(name) for name in VELOCITIES] if is_asked else []
        self._period_s = period_s
        self._rows = array("d")  # time, then commanded and measured velocity; NaN where it does not follow on
        self._before: tuple[int, float, Floats, Floats, float] | None = None

    def add(self, number: int, time_s: float, command: Floats, root_pos: Floats, quat_wxyz: Floats) -> None:
        """Add a tick that counts: its number and time [s], command, place [m] and orientation of the root."""
        asked = command[self._elements]
        if not self._elements or not np.isfinite(asked).all():  # a policy that listens to no velocity drives
            return
        yaw = float(roll_pitch_yaw(quat_wxyz)[2])
        before, self._before = self._before, (number, time_s, asked, root_pos, yaw)
        if before is None or number != before[0] + 1:
            self._rows.extend([math.nan] * 7)
            return
        _, at_s, commanded, place, heading = before
        turned = math.remainder(yaw - heading, 2 * math.pi)
        way, heading = root_pos - place, heading + turned / 2
        forward, left = math.cos(heading), math.sin(heading)
        moved = (way[0] * forward + way[1] * left, way[1] * forward - way[0] * left, turned)
        self._rows.extend([at_s, *commanded, *(value / self._period_s for value in moved)])

    def found(self) -> VelocityFound | None:
        """Return what was found; None where no velocity was asked for, or for less than a second on end."""
        rows, window = self._all, self._window
        errors = [_smooth(run[:, 4:] - run[:, 1:4], window) for run in _runs(rows) if len(run) >= window]
        if not errors:
            return None
        vx, vy, wz = np.abs(np.concatenate(errors)).mean(axis=0).tolist()
        longest = sorted(self._stretches(rows), key=lambda each: -each.seconds)[:MOST_STRETCHES]
        return VelocityFound((vx, vy, wz), tuple(sorted(longest, key=lambda each: each.at_s)))

    def curves(self) -> Floats:
        """Return what a plot shows: time [s], then vx, vy [m/s], wz [rad/s] as commanded, and as means over a second.

        Shape (n, 7); a row that is no number stands between what does not follow on.
        """
        window, gap = self._window, np.full((1, 7), math.nan)
        found = []
        for run in _runs(self._all):
            if len(run) >= window:
                begin = (window - 1) // 2  # the tick in the middle of the first window
                plain = run[begin : begin + len(run) - window + 1, :4]
                found += [np.hstack([plain, _smooth(run[:, 4:], window)]), gap]
        return np.concatenate(found[:-1]) if found else np.empty((0, 7))

    @property
    def _all(self) -> Floats:
        return np.frombuffer(self._rows, dtype=np.float64).reshape(-1, 7)

    @property
    def _window(self) -> int:
        return max(1, round(WINDOW_S / self._period_s))

    def _stretches(self, rows: Floats) -> Iterator[VelocityStretch]:
        settles, shortest = round(SETTLES_S / self._period_s), round(SHORTEST_S / self._period_s)
        for run in _runs(rows):
            changes = np.flatnonzero((run[1:, 1:4] != run[:-1, 1:4]).any(axis=1)) + 1
            for stretch in np.split(run, changes):
                if len(stretch) >= shortest:
                    commanded, measured = stretch[0, 1:4].tolist(), stretch[settles:, 4:].mean(axis=0).tolist()
                    yield VelocityStretch(
                        float(stretch[0, 0]), len(stretch) * self._period_s, tuple(commanded), tuple(measured)
                    )


def _runs(rows: Floats) -> Iterator[Floats]:
    """Yield the runs of rows that follow on one another."""
    for run in np.split(rows, np.flatnonzero(np.isnan(rows[:, 1]))):
        yield run[1:] if len(run) and np.isnan(run[0, 1]) else run


def _smooth(rows: Floats, window: int) -> NDArray[np.float64]:
    """Return the means over each window of rows."""
    sums = np.cumsum(np.concatenate([np.zeros((1, rows.shape[1])), rows]), axis=0)
    return np.asarray((sums[window:] - sums[:-window]) / window)
