"""A person's motion as a file: a numpy ``.npz`` archive (no pickle inside).

| member | shape, type | content |
|---|---|---|
| ``positions`` | (n, 24, 3) float | joints in the order of `station.bus.joints.SMPL_24`, x forward, y left, z up [m] |
| ``quats_wxyz`` | (n, 24, 4) float | their orientations in the world; identity in a T-pose that looks along x |
| ``times_s`` | (n,) float | when each was captured, on one clock, strictly rising [s] |
| ``height_m`` | () float | how tall the person is; absent or NaN where a calibration is given [m] |

Members beyond these are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adapters.motions import npz_archive, raw
from station.bus.joints import SMPL_24
from station.errors import BadFile
from station.operator.sample import Body
from station.protocols import Floats

_SHAPES: dict[str, tuple[int, ...]] = {
    "positions": (len(SMPL_24), 3), "quats_wxyz": (len(SMPL_24), 4), "times_s": (),
}  # fmt: skip
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Skeletons:
    """A person's motion.

    Attributes:
        positions: Shape (n, 24, 3) [m].
        quats_wxyz: Shape (n, 24, 4).
        times_s: Shape (n,), strictly rising [s].
        height_m: How tall the person is [m]; None where the file does not say.
    """

    positions: Floats
    quats_wxyz: Floats
    times_s: Floats
    height_m: float | None = None

    def __len__(self) -> int:
        return len(self.times_s)

    def body(self, index: int) -> Body:
        """Return one frame."""
        return Body(self.positions[index], self.quats_wxyz[index])

    def capture_ns(self, index: int) -> int:
        """Return when a frame was captured [ns]."""
        return round(float(self.times_s[index]) * 1e9)


def load(path: Path) -> Skeletons:
    """Read a person's motion.

    Raises:
        BadFile: missing, torn, too large, or without these members.
    """
    members = _members(path, raw.read_bytes(path))
    arrays = {name: _checked(path, name, members[name]) for name in _SHAPES}
    times = arrays["times_s"]
    if len({len(array) for array in arrays.values()}) != 1 or len(times) < 2:
        listed = ", ".join(f"{name} {len(array)}" for name, array in arrays.items())
        raise BadFile(f"{path}: frames per member: {listed}; expected one number of frames, at least 2")
    if (np.diff(times) <= 0).any():
        raise BadFile(f"{path}: times_s does not rise at frame {int((np.diff(times) <= 0).argmax()) + 1}")
    norms = np.linalg.norm(arrays["quats_wxyz"], axis=-1)
    if (np.abs(norms - 1.0) > _UNIT_TOLERANCE).any():
        frame, joint = np.unravel_index(int(np.abs(norms - 1.0).argmax()), norms.shape)
        raise BadFile(
            f"{path}: {SMPL_24[joint]} of frame {frame}: quaternion of length {norms[frame, joint]:.2f}, expected 1"
        )
    return Skeletons(arrays["positions"], arrays["quats_wxyz"], times, _height(path, members.get("height_m")))


def save(path: Path, skeletons: Skeletons) -> None:
    """Write a person's motion.

    Raises:
        BadFile: the file cannot be written.
    """
    try:
        with path.open("wb") as stream:  # a stream, because numpy would add a suffix to a path without one
            np.savez_compressed(
                stream,
                positions=skeletons.positions,
                quats_wxyz=skeletons.quats_wxyz,
                times_s=skeletons.times_s,
                height_m=np.float64(np.nan if skeletons.height_m is None else skeletons.height_m),
            )
    except OSError as error:
        raise BadFile(f"{path}: cannot be written: {error.strerror}") from error


def _members(path: Path, data: bytes) -> dict[str, np.ndarray[Any, Any]]:
    found, _ = npz_archive.read(path, data, (*_SHAPES, "height_m"), what="skeleton file")
    missing = [name for name in _SHAPES if name not in found]
    if missing:
        raise BadFile(f"{path}: has no member {missing[0]!r}; expected {', '.join(_SHAPES)}")
    return found


def _checked(path: Path, name: str, array: np.ndarray[Any, Any]) -> Floats:
    shape = _SHAPES[name]
    if array.dtype.kind != "f" or array.shape[1:] != shape or array.ndim != len(shape) + 1:
        expected = ", ".join(("frames", *map(str, shape)))
        raise BadFile(f"{path}: {name} is {array.dtype} of shape {array.shape}; expected numbers of shape ({expected})")
    bad = ~np.isfinite(array).reshape(len(array), -1).all(axis=1)
    if bad.any():
        raise BadFile(f"{path}: {name} is not finite in frame {int(bad.argmax())} of {len(array)}")
    return np.asarray(array, dtype=np.float64)


def _height(path: Path, array: np.ndarray[Any, Any] | None) -> float | None:
    if array is None or (array.size == 1 and array.dtype.kind == "f" and np.isnan(array).all()):
        return None
    if array.size != 1 or array.dtype.kind not in "fi" or not 0.5 <= float(array.reshape(-1)[0]) <= 2.5:
        raise BadFile(f"{path}: height_m is {str(array)[:40]}; expected one number of metres, 0.5 to 2.5")
    return float(array.reshape(-1)[0])
