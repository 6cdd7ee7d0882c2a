"""Velocities of the root from its poses and the device's own times.

A loop that polls at 100 Hz sees each sample of a 72 Hz headset once or twice; differences over the loop's time would be
zero, then a spike. Here a sample counts once, at the time it was captured.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from station import rotations
from station.protocols import Floats


class RootVelocity:
    """The slope of a straight line through the samples of a short window; it is half the window late.

    Args:
        window_s: Length of the window [s]; two samples are always in it.
    """

    def __init__(self, window_s: float = 0.06) -> None:
        self.latency_s = window_s / 2.0
        self._window_s = window_s
        self._samples: deque[tuple[float, Floats, Floats]] = deque(maxlen=64)

    def reset(self) -> None:
        """Forget everything; velocities begin at zero."""
        self._samples.clear()

    def step(self, position: Floats, quat_wxyz: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Return linear [m/s] and angular velocity [rad/s] of the root in its own frame, shape (3,) each.

        Args:
            position: Of the root, shape (3,) [m].
            quat_wxyz: Its orientation, shape (4,).
            time_s: When it was captured; later than the last one [s].
        """
        self._samples.append((time_s, position, quat_wxyz))
        while len(self._samples) > 2 and time_s - self._samples[0][0] > self._window_s + 1e-6:
            self._samples.popleft()
        if len(self._samples) < 2:
            return np.zeros(3), np.zeros(3)
        times = np.array([sample[0] for sample in self._samples])
        places = np.array([sample[1] for sample in self._samples])
        quats = np.array([sample[2] for sample in self._samples])
        # Turns as seen from the newest orientation, in its own frame: within a window they are small.
        turns = rotations.rotation_vector(rotations.multiply(rotations.inverse(quat_wxyz)[None], quats))
        off = times - times.mean()
        slope = off / (off @ off)
        return rotations.rotate_inverse(quat_wxyz, slope @ places), slope @ turns
