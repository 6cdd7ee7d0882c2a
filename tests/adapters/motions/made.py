"""Motions made by the tests: smooth, and then spoiled in one place at a time."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adapters.motions.raw import RawMotion
from adapters.robots.g1.joints import G1_29
from station import rotations


def smooth(frames: int = 90, fps: float = 30.0) -> RawMotion:
    """A walk of 0.6 m/s that turns at 0.5 rad/s, joints swinging at most 1.2 rad/s."""
    time_s = np.arange(frames) / fps
    yaw = 0.5 * time_s
    pos = np.stack([1.2 * np.sin(yaw), 1.2 * (1 - np.cos(yaw)), 0.78 + 0.02 * np.sin(6 * time_s)], axis=1)
    quat = rotations.from_rotation_vector(np.stack([0 * yaw, 0 * yaw, yaw], axis=1))
    q = 0.3 * np.sin(4 * time_s[:, None] + np.arange(29)) * (np.arange(29) % 6 == 0) + 0.1
    return RawMotion(Path("walk.npz"), "npz", fps, pos, quat, q)


def spoiled(motion: RawMotion, **changes: dict[Any, Any]) -> RawMotion:
    """Replace elements of the arrays: ``spoiled(motion, root_pos={5: nan}, q={range(3, 7): 0, (40, 18): 2})``."""
    arrays: dict[str, Any] = {}
    for name, rows in changes.items():
        arrays[name] = getattr(motion, name).copy()
        for row, value in rows.items():
            arrays[name][row] = value
    return replace(motion, **arrays)


def content(motion: RawMotion) -> dict[str, Any]:
    """The dict that TWIST2 pickles."""
    return {
        "fps": np.float64(motion.fps),
        "root_pos": motion.root_pos,
        "root_rot": np.roll(motion.root_quat_wxyz, -1, axis=1),
        "dof_pos": motion.q,
        "local_body_pos": np.zeros((len(motion), 38, 3), dtype=np.float32),
        "link_body_list": [f"body_{index}" for index in range(38)],
    }


def write_pkl(path: Path, value: Any, protocol: int = 4) -> Path:
    path.write_bytes(pickle.dumps(value, protocol=protocol))
    return path


def write_csv(path: Path, motion: RawMotion) -> Path:
    table = np.concatenate([motion.root_pos, np.roll(motion.root_quat_wxyz, -1, axis=1), motion.q], axis=1)
    np.savetxt(path, table, delimiter=",", fmt="%.10f")
    return path


assert smooth().q.shape[1] == len(G1_29)
