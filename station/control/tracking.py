"""How well a robot follows: one definition for the offline rehearsal and for the check of a recorded episode.

A tick counts while the motion plays (not while it blends in, pauses or leaves) and the gate tracks. Its joint error is
the mean over the commanded joints of |q - commanded q|, where q was measured at the start of the tick and the command
is the one that the policy got in that tick. The error of a run is the mean over its ticks. Height: |z - commanded z|
of the root, where the robot knows its z.
"""

from __future__ import annotations

import numpy as np

from station.protocols import Floats


class TrackingError:
    """Accumulates the errors of a run.

    Args:
        names: Of the command's elements.
        joint_names: Joints of the robot, in the order of `q`.
    """

    def __init__(self, names: tuple[str, ...], joint_names: tuple[str, ...]) -> None:
        pairs = [
            (joint, names.index(f"{name}_pos"))
            for joint, name in enumerate(joint_names)
            if f"{name}_pos" in names
        ]  # fmt: skip
        self._joints = np.array([joint for joint, _ in pairs], dtype=np.intp)
        self._elements = np.array([element for _, element in pairs], dtype=np.intp)
        self._height = names.index("root_height") if "root_height" in names else None
        self._joint_sum, self._height_sum = 0.0, 0.0
        self.ticks = 0
        self._height_ticks = 0

    def add(self, q: Floats, command: Floats, root_height_m: float | None = None) -> None:
        """Take a tick that counts: joints [rad], command vector, height of the root [m] where known."""
        self.ticks += 1
        if len(self._joints):
            self._joint_sum += float(np.abs(q[self._joints] - command[self._elements]).mean())
        if root_height_m is not None and self._height is not None:
            self._height_sum += abs(root_height_m - float(command[self._height]))
            self._height_ticks += 1

    @property
    def mean_joint_error_rad(self) -> float | None:
        """Mean joint error [rad]; None when no tick counted, or no joint is commanded."""
        return self._joint_sum / self.ticks if self.ticks and len(self._joints) else None

    @property
    def mean_root_height_error_m(self) -> float | None:
        """Mean height error [m]; None when no tick counted, or no height is commanded."""
        return self._height_sum / self._height_ticks if self._height_ticks else None
