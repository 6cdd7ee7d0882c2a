"""Motions of the LAFAN1-retargeted kind: text, a frame per line, no header, no rate.

36 columns: root position x y z [m], root quaternion **x y z w**, 29 joints [rad] in the order of
`adapters.robots.g1.joints.G1_29`. The published set has 30 frames per second.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from adapters.motions import raw
from station.errors import BadFile

COLUMNS = 36
DEFAULT_FPS = 30.0


def load(path: Path, *, fps: float | None = None) -> raw.RawMotion:
    """Read a motion.

    Args:
        path: The file.
        fps: Its frames per second; None means 30.

    Raises:
        BadFile: missing, not text, not numbers, or not 36 per line.
    """
    table = _table(path, raw.read_bytes(path))
    if table.shape[1] != COLUMNS:
        raise BadFile(
            f"{path}: {table.shape[1]} columns; expected {COLUMNS}: root x y z, quaternion x y z w, 29 joints"
        )
    return raw.build(
        path,
        format="csv",
        fps=DEFAULT_FPS if fps is None else fps,
        root_pos=table[:, :3],
        root_quat_wxyz=np.roll(table[:, 3:7], 1, axis=1),
        q=table[:, 7:],
    )


def _table(path: Path, data: bytes) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        raise BadFile(f"{path}: byte {error.start} is no text; expected lines of {COLUMNS} numbers") from None
    if not text.strip():
        raise BadFile(f"{path}: holds no frames; expected lines of {COLUMNS} numbers")
    try:
        return np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2, comments=None, dtype=np.float64)
    except ValueError as error:
        reason = " ".join(str(error).split())[:100]
        raise BadFile(f"{path}: {reason}; expected lines of {COLUMNS} numbers and no header") from None
