"""Our own motion file: a numpy ``.npz`` archive (compressed, no pickle inside) with five members.

| member | shape, type | content |
|---|---|---|
| ``fps`` | (), float64 | frames per second; need not be whole |
| ``root_pos`` | (n, 3) float64 | position of the pelvis in the motion's world, z up from the ground [m] |
| ``root_quat_wxyz`` | (n, 4) float64 | orientation of the pelvis in that world |
| ``joint_pos`` | (n, k) float64 | joint positions [rad] |
| ``joint_names`` | (k,) text | names of the columns, as in `adapters.robots.g1.joints.G1_29`; wrists may be absent |

``provenance`` () text may stand beside them: what the motion was made of, a JSON object, for manifests. Members beyond
these are ignored, so a writer may add what it likes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adapters.motions import npz_archive, raw
from station.errors import BadFile
from station.protocols import Floats

_MEMBERS = ("fps", "root_pos", "root_quat_wxyz", "joint_pos", "joint_names")
_LONGEST_PROVENANCE = 1 << 14  # characters


def load(path: Path, *, fps: float | None = None) -> raw.RawMotion:
    """Read a motion.

    Args:
        path: The file.
        fps: Takes the place of the rate in the file.

    Raises:
        BadFile: missing, torn, too large, or without these members.
    """
    members = _members(path, raw.read_bytes(path))
    names = members["joint_names"]
    if names.ndim != 1 or names.dtype.kind != "U":
        raise BadFile(f"{path}: joint_names is {names.dtype} of shape {names.shape}; expected a list of text")
    if members["fps"].size != 1:
        raise BadFile(f"{path}: fps has shape {members['fps'].shape}; expected one number")
    return raw.build(
        path,
        format="npz",
        fps=members["fps"].reshape(-1)[0] if fps is None else fps,
        root_pos=members["root_pos"],
        root_quat_wxyz=members["root_quat_wxyz"],
        q=members["joint_pos"],
        joint_names=tuple(names.tolist()),
        provenance=_provenance(members["provenance"]) if "provenance" in members else None,
    )


def save(
    path: Path, *, fps: float, root_pos: Floats, root_quat_wxyz: Floats, joint_pos: Floats, joint_names: Sequence[str],
    provenance: Mapping[str, Any] | None = None,
) -> None:  # fmt: skip
    """Write a motion, whole or not at all; shapes and units as in the table above.

    Raises:
        BadFile: what would be written could not be read back.
    """
    raw.build(
        path, format="npz", fps=fps, root_pos=root_pos, root_quat_wxyz=root_quat_wxyz, q=joint_pos,
        joint_names=tuple(joint_names),
    )  # fmt: skip
    members: dict[str, Any] = {
        "fps": np.float64(fps), "root_pos": root_pos, "root_quat_wxyz": root_quat_wxyz, "joint_pos": joint_pos,
        "joint_names": np.array(joint_names, dtype=np.str_),
    }  # fmt: skip
    if provenance:
        members["provenance"] = np.array(json.dumps(dict(provenance)))
    temporary = path.with_name(f".{path.name}.new")
    try:
        with temporary.open("wb") as stream:  # a stream, because numpy would add a suffix to a path without one
            np.savez_compressed(stream, **members)
        os.replace(temporary, path)
    except BaseException:  # an interrupt too
        temporary.unlink(missing_ok=True)
        raise


def _provenance(member: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Return the provenance that a file states; empty if its member of that name is another program's."""
    text = str(member.reshape(-1)[0]) if member.dtype.kind == "U" and member.size == 1 else ""
    try:
        told = json.loads(text[:_LONGEST_PROVENANCE])
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}


def _members(path: Path, data: bytes) -> dict[str, np.ndarray[Any, Any]]:
    found, _ = npz_archive.read(path, data, (*_MEMBERS, "provenance"), what=".npz motion", ignored=("provenance",))
    missing = [name for name in _MEMBERS if name not in found]
    if missing:
        raise BadFile(f"{path}: has no member {missing[0]!r}; expected {', '.join(_MEMBERS)}")
    return found
