"""From the frame of headsets (x right, y up, z back) to ours (x forward, y left, z up), both right-handed.

The matrix `T` re-labels axes: ``p' = T p``. Orientations become ``R' = T R Tᵀ``, which re-labels the axes of the *body*
as well as those of the world, so a controller that points forward at rest (its own -z) points along its own +x
afterwards, and the identity stays the identity. (``T R`` alone would keep the controller's own axes; the rotation
between two instants, ``R_now R_startᵀ``, is the same in both.) Head, controllers, body joints and hands are all treated
alike: with different matrices for positions and orientations a hand would move right and turn left.

T is proper (determinant +1), right only for right-handed data. OpenXR's are. XRoboToolkit's are too, though its manual
calls them left-handed: its app sends the runtime's native values for head, controllers and hands, and itself mirrors
the joints of the body out of Unity's left-handed frame (XRoboToolkit-Unity-Client, ``TrackingData.cs``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from station.protocols import Floats

T = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Takes right, up, back to forward, left, up."""
T.flags.writeable = False


def positions_to_flu(positions: ArrayLike) -> Floats:
    """Rotate positions (..., 3) from right, up, back to forward, left, up; the unit stays."""
    return np.asarray(np.asarray(positions, dtype=np.float64) @ T.T)


def positions_from_flu(positions: ArrayLike) -> Floats:
    """Rotate positions (..., 3) the other way."""
    return np.asarray(np.asarray(positions, dtype=np.float64) @ T)


def rotations_to_flu(rotations: ArrayLike) -> Floats:
    """Rotate rotation matrices (..., 3, 3) from right, up, back to forward, left, up."""
    return np.asarray(T @ np.asarray(rotations, dtype=np.float64) @ T.T)


def quats_to_flu(quats_wxyz: ArrayLike) -> Floats:
    """Rotate quaternions (..., 4) from right, up, back to forward, left, up.

    The vector part turns with T and w stays: right because T is proper; a mirror would need a minus.
    """
    quats = np.asarray(quats_wxyz, dtype=np.float64)
    return np.concatenate([quats[..., :1], positions_to_flu(quats[..., 1:])], axis=-1)


def quats_from_flu(quats_wxyz: ArrayLike) -> Floats:
    """Rotate quaternions (..., 4) the other way."""
    quats = np.asarray(quats_wxyz, dtype=np.float64)
    return np.concatenate([quats[..., :1], positions_from_flu(quats[..., 1:])], axis=-1)


def wxyz(quats_xyzw: ArrayLike) -> Floats:
    """Reorder quaternions (..., 4) from ``x y z w``, as headsets send them."""
    return np.roll(np.asarray(quats_xyzw, dtype=np.float64), 1, axis=-1)


def xyzw(quats_wxyz: ArrayLike) -> Floats:
    """Reorder quaternions (..., 4) to ``x y z w``."""
    return np.roll(np.asarray(quats_wxyz, dtype=np.float64), -1, axis=-1)
