"""Smooth ways from one value to another: nothing here has a jump of position, speed or acceleration."""

from __future__ import annotations

import math

import numpy as np

from station.protocols import Floats

FPS = 50.0
"""Frames per second of everything that is made here."""


def times(duration_s: float) -> Floats:
    """Return the instants of the frames of a motion, both ends included [s]."""
    return np.arange(round(duration_s * FPS) + 1) / FPS


def rise(time_s: Floats, start_s: float, end_s: float) -> Floats:
    """Go from 0 to 1 between two instants with the least jerk; at rest, without acceleration, before and after."""
    part = np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0)
    return np.asarray(part**3 * (10.0 - 15.0 * part + 6.0 * part**2))


def bump(time_s: Floats, start_s: float, end_s: float) -> Floats:
    """Go from 0 to 1 and back between two instants; at rest, without acceleration, before and after."""
    part = np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0)
    return np.asarray(64.0 * (part * (1.0 - part)) ** 3)


def sway_under(zmp: Floats, height_m: float) -> Floats:
    """Return how a centre of mass at a height moves when the floor pushes at given points (the ZMP).

    The linear inverted pendulum c'' = (g / height) (c - p) has one solution that stays bounded: p, smoothed by a
    two-sided exponential of time constant sqrt(height / g). It looks ahead, as one who knows his next steps does. The
    same holds frame by frame, with central differences, for powers of the root of r + 1/r = 2 + (dt / constant)^2.

    Args:
        zmp: Points, shape (n, k) [m], one per frame; before the first and after the last frame the ends hold.
        height_m: Of the centre of mass above the floor [m].
    """
    step = 9.81 / height_m / FPS**2
    root = 1.0 + step / 2.0 - math.sqrt(step + step**2 / 4.0)
    reach = math.ceil(math.log(1e-6) / math.log(root))
    kernel = root ** np.abs(np.arange(-reach, reach + 1))
    padded = np.pad(zmp, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T], axis=1)


def below(wish: Floats, limit: Floats, within_s: float) -> Floats:
    """Return a smooth way near a wished one and nowhere above a limit; it gives way this long before and after [s]."""
    reach = max(round(within_s * FPS), 1)
    excess = np.pad(np.maximum(wish - limit, 0.0), 2 * reach, mode="edge")
    worst = np.lib.stride_tricks.sliding_window_view(excess, 2 * reach + 1).max(axis=1)
    kernel = bump(np.arange(2 * reach + 1.0), -1.0, 2.0 * reach + 1.0)
    return np.asarray(wish - np.convolve(worst, kernel / kernel.sum(), mode="valid"))
