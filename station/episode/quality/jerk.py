"""Jerk: the third derivative of the cubic that fits 7 neighbouring positions best (Savitzky-Golay).

Their time is taken as even: 6 c3 / dt^3 with dt the mean interval of the seven (or of as many as span 0.12 s). So a
time stamp that is a millisecond off says nothing, and a quantum of 0.1 mrad 1.5 rad/s^3; a walk has thousands.
Neighbours with a gap between them (1.5 times the median interval) are not fitted.
"""

from __future__ import annotations

from array import array

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from station.episode.reading.messages import Ints
from station.protocols import Floats

_JERK_S, _LEAST_POINTS, _MOST_POINTS = 0.12, 7, 101
_GAP = 1.5  # of the median interval


class Jerk:
    """The greatest jerk of any joint, for each instant."""

    def __init__(self) -> None:
        self._tail: tuple[Ints, Floats] | None = None
        self._weights: Floats = np.empty(0)
        self._greatest = array("d")
        self._most, self._joint = 0.0, ""

    def feed(self, times: Ints, joints: tuple[str, ...], q: Floats) -> None:
        """Take positions (k, n) [rad] at times (k,) [ns]."""
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
        self._note(jerk[fits & np.isfinite(jerk).all(axis=1)], joints)

    def _note(self, jerk: Floats, joints: tuple[str, ...]) -> None:
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
