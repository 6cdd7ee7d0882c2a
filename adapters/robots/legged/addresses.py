"""Where root and joints of a robot on legs stand in the arrays of a MuJoCo model, whatever else is in it."""

from __future__ import annotations

import mujoco
import numpy as np

from adapters.robots.legged import mjcf
from adapters.robots.legged.table import LeggedRobot


class Addresses:
    """Indices into the arrays of one model; n joints, in the order of the robot's table.

    Attributes:
        q, v: Of the joints in ``qpos`` and in ``qvel``, shape (n,) each.
        u: Of their position actuators in ``ctrl``, shape (n,).
        root_q: Of the root's position and quaternion wxyz in ``qpos``, shape (7,).
        root_v: Of its linear (world frame) and angular (body frame) velocity in ``qvel``, shape (6,).
    """

    def __init__(self, robot: LeggedRobot, model: mujoco.MjModel) -> None:
        named = {model.joint(index).name for index in range(model.njnt)}
        joints = [model.joint(mjcf.in_model(joint, named)) for joint in robot.joints]
        self.q = np.array([joint.qposadr[0] for joint in joints])
        self.v = np.array([joint.dofadr[0] for joint in joints])
        actuator_of = {int(model.actuator_trnid[u, 0]): u for u in range(model.nu)}
        self.u = np.array([actuator_of[joint.id] for joint in joints])
        free = model.body(robot.root).jntadr[0]
        self.root_q = np.arange(7) + model.jnt_qposadr[free]
        self.root_v = np.arange(6) + model.jnt_dofadr[free]
