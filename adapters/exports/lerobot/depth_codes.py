"""Depth as LeRobot 0.6 keeps it in video: codes of 12 bits, even in the logarithm of the distance plus a shift.

So steps are 1.2 mm near the camera, 1.5 mm at 1 m, 4.4 mm at 10 m: stereo cameras are less sure of what is far, too.
What was not measured has code 0, which LeRobot reads as the nearest distance; what is farther than the last code has
that one.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.depth import Steps
from station.protocols import Floats

NEAREST_M, FARTHEST_M, SHIFT_M = 0.01, 10.0, 3.5
"""Of the first and the last code, and what is added to a distance before its logarithm is taken; LeRobot's own."""

CODES = 4096
INFO: dict[str, Any] = {
    "depth_unit": "mm", "video.depth_min": NEAREST_M, "video.depth_max": FARTHEST_M, "video.shift": SHIFT_M,
    "video.use_log": True,
}  # fmt: skip
"""What of it stands in the description of a column."""

RULE = (
    f"video of 12 bits without loss (hevc); {NEAREST_M:g} to {FARTHEST_M:g} m in {CODES} codes, steps of 1.5 mm at 1 m "
    f"and 4.4 mm at 10 m; what was not measured reads as {NEAREST_M:g} m"
)

_FIRST, _LAST = math.log(NEAREST_M + SHIFT_M), math.log(FARTHEST_M + SHIFT_M)


def codes_of(steps: Steps, step_m: float) -> NDArray[np.uint16]:
    """Return the codes of a depth picture whose step is so long [m]; same shape."""
    found: NDArray[np.uint16] = _codes(step_m)[steps]
    return found


@lru_cache(maxsize=8)
def _codes(step_m: float) -> NDArray[np.uint16]:
    """Return the code of every number of steps, shape (65536,)."""
    logarithms = np.log(np.arange(1 << 16) * step_m + SHIFT_M)
    share = (logarithms - _FIRST) / (_LAST - _FIRST)
    codes: NDArray[np.uint16] = np.rint(share * (CODES - 1)).clip(0, CODES - 1).astype(np.uint16)
    return codes


def millimetres() -> Floats:
    """Return what LeRobot reads of each code [mm], shape (4096,)."""
    logarithms: Floats = _FIRST + np.arange(CODES) / (CODES - 1) * (_LAST - _FIRST)
    return np.rint(1e3 * (np.exp(logarithms) - SHIFT_M))
