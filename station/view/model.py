"""A robot's model as a viewer needs it: shapes, and where each body is for given joint positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from station import rotations
from station.errors import BadFile
from station.protocols import Floats
from station.view.shapes import Shape, shapes

_ROOT_SIZE = 7  # position and quaternion of a free joint


class RobotModel:
    """Forward kinematics of a robot that walks, or of one that stands fast, from its MJCF.

    Args:
        path: MJCF file.

    Attributes:
        floats: Whether its root moves freely.
        bodies: Names of the bodies, the world left out.
        shapes: What is to be seen of them.
        visible: Bodies that have a shape.

    Raises:
        BadFile: MuJoCo cannot read it, or nothing of it moves.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._model: Any = mujoco.MjModel.from_xml_path(str(path))
        except (ValueError, mujoco.FatalError) as error:
            reason = " ".join(str(error).split())
            raise BadFile(f"{path}: not a robot model that MuJoCo {mujoco.__version__} reads: {reason}") from error
        if self._model.njnt == 0:
            raise BadFile(f"{path}: expected a robot, got a model without joints; name another one")
        self.floats = int(self._model.jnt_type[0]) == int(mujoco.mjtJoint.mjJNT_FREE)
        self._data: Any = mujoco.MjData(self._model)
        self._address = {self._model.joint(i).name: int(self._model.jnt_qposadr[i]) for i in range(self._model.njnt)}
        self.bodies: tuple[str, ...] = tuple(self._model.body(i).name for i in range(1, self._model.nbody))
        self.shapes: list[Shape] = shapes(self._model)
        self.visible: frozenset[str] = frozenset(shape.body for shape in self.shapes)

    def knows(self, joint: str) -> bool:
        """Whether the model has a joint of this name (the wire leaves out MJCF's ``_joint``)."""
        return self._find(joint) is not None

    def poses(self, root: Floats, joints: Sequence[str], q: Floats) -> tuple[Floats, Floats]:
        """Return where every body is in the world, for n instants.

        Args:
            root: Position [m] and quaternion wxyz of the root, or of the base that stands fast, shape (n, 7).
            joints: Names of m joints; those that the model lacks are left out, those not named stay at zero.
            q: Their positions, shape (n, m) [rad].

        Returns:
            Positions, shape (n, bodies, 3) [m], and quaternions wxyz, shape (n, bodies, 4), in the order of `bodies`.
        """
        pairs = [(column, self._find(name)) for column, name in enumerate(joints)]
        columns = np.array([column for column, address in pairs if address is not None], dtype=int)
        addresses: NDArray[np.int64] = np.array([a for _, a in pairs if a is not None], dtype=np.int64)
        positions = np.empty((len(root), len(self.bodies), 3))
        quaternions = np.empty((len(root), len(self.bodies), 4))
        data = self._data
        for index in range(len(root)):
            data.qpos[:] = self._model.qpos0
            if self.floats:
                data.qpos[:_ROOT_SIZE] = root[index]
            data.qpos[addresses] = q[index, columns]
            mujoco.mj_kinematics(self._model, data)
            positions[index], quaternions[index] = data.xpos[1:], data.xquat[1:]
        if self.floats:
            return positions, quaternions
        base = root[:, None, 3:]
        return root[:, None, :3] + rotations.rotate(base, positions), rotations.multiply(base, quaternions)

    def _find(self, joint: str) -> int | None:
        return self._address.get(joint, self._address.get(f"{joint}_joint"))
