"""A motion in memory that can be sampled at any time."""

from __future__ import annotations

from typing import Any

import numpy as np

from adapters.motions.raw import RawMotion
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.protocols import Floats, Reference


class Clip:
    """A motion of the G1 (`station.protocols.Motion`), from frames that are all good.

    Between two frames positions and joints are linear and the rotation is a slerp. Velocities are central differences
    of the frames (one-sided at the two ends), in the root frame. They too are interpolated: stock TWIST2 takes those of
    the lower frame, which at 50 Hz from 30 frames a second repeats one value and jumps at the next.

    Args:
        motion: The frames; quaternions of unit length.
        facts: What a manifest says of this motion.
        name: Short name; that of the file when None.
    """

    def __init__(self, motion: RawMotion, *, facts: dict[str, Any] | None = None, name: str | None = None) -> None:
        self._name = motion.path.stem if name is None else name
        self._fps = motion.fps
        self._facts = dict(facts or {})
        self._position, self._q = motion.root_pos, motion.q
        self._quats = _same_hemisphere(motion.root_quat_wxyz)
        self._last = len(motion) - 1
        velocity, turn = _velocities(self._position, self._quats, motion.fps)
        self._linear = np.concatenate([self._position, velocity, turn, self._q], axis=1)

    @property
    def name(self) -> str:
        """Name of the file, without its suffix."""
        return self._name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The 29 joints of the G1."""
        return G1_29

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last [s]."""
        return self._last / self._fps

    @property
    def fps(self) -> float:
        """Rate of the recorded frames [Hz]."""
        return self._fps

    def at(self, time_s: float) -> Reference:
        """Return the reference at a time [s], clamped to 0..duration_s."""
        place = min(max(time_s * self._fps, 0.0), float(self._last))
        lower = min(int(place), self._last - 1)
        part = place - lower
        row = self._linear[lower] + part * (self._linear[lower + 1] - self._linear[lower])
        quat = rotations.slerp(self._quats[lower], self._quats[lower + 1], part)
        return Reference(root_pos=row[:3], root_quat_wxyz=quat, root_lin_vel=row[3:6], root_ang_vel=row[6:9], q=row[9:])

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this motion."""
        return dict(self._facts)


def _velocities(position: Floats, quats: Floats, fps: float) -> tuple[Floats, Floats]:
    """Return linear [m/s] and angular [rad/s] velocity at each frame, in the root frame, shapes (n, 3)."""
    before = np.maximum(np.arange(len(quats)) - 1, 0)
    after = np.minimum(np.arange(len(quats)) + 1, len(quats) - 1)
    span_s = ((after - before) / fps)[:, None]
    moved = position[after] - position[before]
    turned = rotations.rotation_vector(rotations.multiply(quats[after], rotations.inverse(quats[before])))
    return rotations.rotate_inverse(quats, moved / span_s), rotations.rotate_inverse(quats, turned / span_s)


def _same_hemisphere(quats: Floats) -> Floats:
    """Choose signs so that neighbours lie on one side; q and -q are the same rotation."""
    flips = np.where((quats[1:] * quats[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    signs = np.concatenate([[1.0], np.cumprod(flips)])
    return np.asarray(quats * signs[:, None])
