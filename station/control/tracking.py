"""How well a robot follows: one definition for rehearsals, the check of an episode, its plots and its report.

A tick counts while the motion plays (not while it blends in, pauses or leaves) and the gate tracks. The error of a
joint is the mean over these ticks of |q - commanded q|, where q was measured at the start of the tick and the command
is the one that the policy got in that tick; the error of a run is the mean over its joints and ticks. What is no number
was not measured, and does not count. Height: |z - commanded z| of the root, where the robot knows its z.
"""

from __future__ import annotations

import numpy as np

from station.protocols import LARGEST_JOINT_ERROR_RAD, Floats


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
        if root_height_m is not None and self._height is not None:
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
