"""The clip inside a checkpoint of Holosoma's whole-body tracking: an ``.onnx`` file that returns a row per time step.

Outputs, of one row: ``joint_pos`` (1, 29) [rad], ``ref_pos_xyz`` (1, 3) [m] and ``ref_quat_xyzw`` (1, 4) of the torso
link in the clip's world. Beyond the last row the network returns that. Wire facts: PyPI ``holosoma-inference`` 0.1.3,
``policies/wbt_utils.py``.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from adapters.motions import raw
from adapters.motions.clip import Clip
from adapters.retarget.bone_frames import to_quats
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.kinematics import INDEX, forward
from station import assets, rotations
from station.errors import BadFile
from station.protocols import Floats

FPS = 50.0
OUTPUTS = {"joint_pos": len(G1_29), "ref_pos_xyz": 3, "ref_quat_xyzw": 4}
_TORSO = INDEX["torso"]
_LONGEST = 1 << 17  # rows; forty minutes
_BEYOND = 1e7  # a time step after the last row


class Reader:
    """Reads a motion; it begins at the origin and looks along X.

    No frame of it is mended: a policy was trained on each, however fast it is.

    Attributes:
        is_listed: Whether any file of this suffix is listed as a motion. Most checkpoints hold none.
    """

    is_listed = False

    def __call__(self, path: Path, *, fps: float | None = None) -> Clip:
        """Read a motion.

        Args:
            path: The file.
            fps: Takes the place of 50.

        Raises:
            BadFile: missing, no ONNX, or without such a clip.
        """
        rows = _rows(path)
        if not np.isfinite(rows).all():
            raise BadFile(f"{path}: its clip holds numbers that are not finite")
        q, position, quat = np.split(rows, np.cumsum([*OUTPUTS.values()])[:-1], axis=1)
        in_root = forward(np.zeros((len(q), 3)), np.tile([1.0, 0, 0, 0], (len(q), 1)), q)
        waist = to_quats(in_root.rotation[_TORSO])
        root = rotations.multiply(rotations.normalized(quat[:, [3, 0, 1, 2]]), rotations.inverse(waist))
        root_pos = position - rotations.rotate(root, in_root.position[_TORSO])
        yaw = rotations.roll_pitch_yaw(root[0])[2]
        back = rotations.from_rotation_vector([0.0, 0.0, -yaw])
        root_pos = rotations.rotate(back, root_pos - root_pos[0] * [1, 1, 0])
        made = raw.build(
            path, format="onnx", fps=FPS if fps is None else fps, root_pos=root_pos,
            root_quat_wxyz=rotations.multiply(back, root), q=q,
        )  # fmt: skip
        facts = {"file": str(path), "sha256": assets.sha256(path), "format": made.format, "fps": made.fps,
                 "duration_s": (len(made) - 1) / made.fps}  # fmt: skip
        return Clip(made, facts=facts)


READER = Reader()


def _rows(path: Path) -> Floats:
    """Return all rows of the clip, outputs side by side, shape (n, 36)."""
    from adapters.policies.onnx_network import open_session  # what runs it takes a moment to import

    session = open_session(path)
    given = {port.name: port.shape for port in session.get_inputs()}
    made = {port.name: port.shape for port in session.get_outputs()}
    if "time_step" not in given or any(made.get(name) != [1, size] for name, size in OUTPUTS.items()):
        raise BadFile(
            f"{path}: holds no clip; expected an input time_step and outputs "
            f"{', '.join(f'{name} [1, {size}]' for name, size in OUTPUTS.items())}, it has {made}"
        )
    still = {name: np.zeros([size if isinstance(size, int) else 1 for size in shape], np.float32)
             for name, shape in given.items()}  # fmt: skip

    def row(time_step: float) -> Floats:
        found = session.run(list(OUTPUTS), still | {"time_step": np.full((1, 1), time_step, np.float32)})
        return np.concatenate([part.ravel() for part in found]).astype(np.float64)

    last, rows = row(_BEYOND), list[Floats]()
    for step in itertools.count():
        rows.append(row(step))
        if len(rows) > 1 and (rows[-1] == last).all() and (rows[-2] == last).all():
            return np.array(rows[:-1])
        if step > _LONGEST:
            raise BadFile(f"{path}: its clip does not end within {_LONGEST} rows")
    raise AssertionError
