"""TWIST, TWIST2 and GMR motions: a pickled dict, read without running anything that the file asks for.

Keys: ``fps``; ``root_pos`` (n, 3) [m]; ``root_rot`` (n, 4) quaternion **x y z w**; ``dof_pos`` (n, 29 or 23) [rad];
``local_body_pos`` (n, bodies, 3) and ``link_body_list``, both unused here and None in files of GMR's scripts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from adapters.motions import raw
from adapters.motions.safe_pickle import load_plain
from station.errors import BadFile

_NEEDED = ("fps", "root_pos", "root_rot", "dof_pos")
_OPTIONAL = ("local_body_pos", "link_body_list")


def load(path: Path, *, fps: float | None = None) -> raw.RawMotion:
    """Read a motion.

    Args:
        path: The file.
        fps: Takes the place of the rate in the file.

    Raises:
        BadFile: missing, torn, malicious, or not such a dict.
    """
    content = load_plain(path, raw.read_bytes(path))
    _check_keys(path, content)
    _check_bodies(path, content)
    rotation = content["root_rot"]
    if not isinstance(rotation, np.ndarray) or rotation.ndim != 2 or rotation.shape[1] != 4:
        shape = getattr(rotation, "shape", type(rotation).__name__)
        raise BadFile(f"{path}: root_rot is {shape}; expected numbers of shape (frames, 4), x y z w")
    return raw.build(
        path,
        format="pkl",
        fps=content["fps"] if fps is None else fps,
        root_pos=content["root_pos"],
        root_quat_wxyz=np.roll(rotation, 1, axis=1),
        q=content["dof_pos"],
    )


def _check_keys(path: Path, content: Any) -> None:
    if not isinstance(content, dict):
        raise BadFile(f"{path}: holds {type(content).__name__}; expected a dict with {', '.join(_NEEDED)}")
    missing = [key for key in _NEEDED if key not in content]
    if missing:
        raise BadFile(f"{path}: has no {missing[0]!r}; expected a dict with {', '.join(_NEEDED)}")
    unknown = [key for key in content if key not in _NEEDED + _OPTIONAL]
    if unknown:
        name = repr(unknown[0][:40]) if isinstance(unknown[0], str) else f"of type {type(unknown[0]).__name__}"
        raise BadFile(f"{path}: unknown key {name}; known: {', '.join(_NEEDED + _OPTIONAL)}")


def _check_bodies(path: Path, content: dict[str, Any]) -> None:
    bodies = content.get("local_body_pos")
    if bodies is not None and not (isinstance(bodies, np.ndarray) and bodies.ndim == 3 and bodies.shape[2] == 3):
        raise BadFile(f"{path}: local_body_pos is {getattr(bodies, 'shape', type(bodies).__name__)}; "
                      "expected None or numbers of shape (frames, bodies, 3)")  # fmt: skip
