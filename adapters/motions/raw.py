"""What a motion file holds, before anything is mended: the one type that every reader returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.joints import G1_23, G1_29
from station.errors import BadFile
from station.protocols import Floats

MAX_BYTES = 1 << 29
"""No motion file of ours is larger: an hour at 120 Hz with every body position has 0.4 GB."""


_FASTEST = 1e6  # frames per second


@dataclass(frozen=True, slots=True)
class RawMotion:
    """The frames of a file as they stand there: shapes are right, values may be anything, even NaN.

    Attributes:
        path: The file.
        format: Name of its reader: ``pkl``, ``npz`` or ``csv``.
        fps: Frames per second; need not be whole.
        root_pos: Position of the pelvis in the motion's world, z up, shape (n, 3) [m].
        root_quat_wxyz: Orientation of the pelvis in that world, shape (n, 4).
        q: Joint positions in the order of `adapters.robots.g1.joints.G1_29`, shape (n, 29) [rad].
        filled: Joints that the file does not have; they are zero.
        provenance: What the file says of where it is from.
    """

    path: Path
    format: str
    fps: float
    root_pos: Floats
    root_quat_wxyz: Floats
    q: Floats
    filled: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.q)


def read_bytes(path: Path) -> bytes:
    """Return the content of a motion file.

    Raises:
        BadFile: missing, not a file, not readable, empty or too large.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise BadFile(f"{path}: is not a file; name a motion file")
        if size > MAX_BYTES:
            raise BadFile(f"{path}: {size / 1e6:.0f} MB, a motion file has at most {MAX_BYTES / 1e6:.0f} MB")
        data = path.read_bytes()
    except OSError as error:
        raise BadFile(f"{path}: cannot be read: {error.strerror}") from error
    if not data:
        raise BadFile(f"{path}: the file is empty; fetch or export it again")
    return data


def build(
    path: Path,
    *,
    format: str,
    fps: float,
    root_pos: Any,
    root_quat_wxyz: Any,
    q: Any,
    joint_names: tuple[str, ...] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> RawMotion:
    """Check the shapes of what a reader found and put the joints into G1 order; absent wrists become zero.

    Args:
        path: The file, for messages.
        format: Name of the reader.
        fps: Frames per second.
        root_pos: Numbers, shape (n, 3) [m].
        root_quat_wxyz: Numbers, shape (n, 4).
        q: Numbers, shape (n, k) [rad].
        joint_names: Names of the k columns; None means the 29 joints of TWIST2 or the 23 of TWIST, told by k.
        provenance: What the file says of where it is from.

    Raises:
        BadFile: a shape, a type, a rate or a joint name is wrong.
    """
    position = _table(path, "root_pos", root_pos, 3)
    orientation = _table(path, "the root rotation", root_quat_wxyz, 4)
    columns = _table(path, "the joint positions", q, None)
    lengths = {len(position), len(orientation), len(columns)}
    if len(lengths) != 1:
        listed = f"{len(position)}, {len(orientation)} and {len(columns)}"
        raise BadFile(f"{path}: root position, root rotation and joints have {listed} frames; expected equal numbers")
    if len(columns) < 2:
        raise BadFile(f"{path}: {len(columns)} frames; a motion has at least 2")
    names = _names_by_count(path, columns.shape[1]) if joint_names is None else _known(path, joint_names, columns)
    ordered = np.zeros((len(columns), len(G1_29)))
    ordered[:, [G1_29.index(name) for name in names]] = columns
    filled = tuple(name for name in G1_29 if name not in names)
    return RawMotion(path, format, checked_fps(path, fps), position, orientation, ordered, filled, provenance or {})


def checked_fps(path: Path, fps: Any) -> float:
    """Return a frame rate as a float.

    Raises:
        BadFile: not a positive finite number.
    """
    came = repr(fps[:40]) if isinstance(fps, str) else type(fps).__name__
    if isinstance(fps, (int, float, np.integer, np.floating)) and not isinstance(fps, bool):
        rate: Any = fps
        if 0 < rate < _FASTEST:  # also of an integer that is too long for a float
            return float(rate)
        came = str(rate) if isinstance(rate, float) or abs(rate) < _FASTEST else "a number that is too large"
    raise BadFile(f"{path}: fps is {came}; expected a positive number of frames per second")


def _table(path: Path, name: str, value: Any, width: int | None) -> Floats:
    expected = f"numbers of shape (frames, {width or '29 or 23'})"
    if not isinstance(value, np.ndarray):
        raise BadFile(f"{path}: {name} is {type(value).__name__}; expected {expected}")
    if value.dtype.kind not in "fiu":
        raise BadFile(f"{path}: {name} holds {value.dtype}; expected {expected}")
    if value.ndim != 2 or (width is not None and value.shape[1] != width):
        raise BadFile(f"{path}: {name} has shape {value.shape}; expected {expected}")
    table: NDArray[np.float64] = np.ascontiguousarray(value, dtype=np.float64)
    return table


def _names_by_count(path: Path, count: int) -> tuple[str, ...]:
    for names in (G1_29, G1_23):
        if count == len(names):
            return names
    raise BadFile(f"{path}: {count} joints per frame; expected 29 (TWIST2, LAFAN1 for the G1) or 23 (TWIST)")


def _known(path: Path, names: tuple[str, ...], columns: Floats) -> tuple[str, ...]:
    short = tuple(name.removesuffix("_joint") for name in names)
    if len(short) != columns.shape[1] or len(set(short)) != len(short):
        raise BadFile(
            f"{path}: {len(set(short))} different joint names for {columns.shape[1]} columns; expected one each"
        )
    unknown = [name for name in short if name not in G1_29]
    missing = [name for name in G1_23 if name not in short]
    if unknown:
        raise BadFile(
            f"{path}: joint {unknown[0]!r} is none of the G1's; names are as in adapters.robots.g1.joints.G1_29"
        )
    if missing:
        raise BadFile(f"{path}: joint {missing[0]!r} is missing; only wrists may be left out")
    return short
