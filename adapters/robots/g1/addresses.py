"""Where the root and the 29 joints of a G1 stand in the arrays of a MuJoCo model, whatever else is in it."""

from __future__ import annotations

import mujoco
import numpy as np

from adapters.robots.g1 import mjcf
from adapters.robots.g1.joints import G1_29, select


class Addresses:
    """Indices into the arrays of one model; joints in Unitree's motor order.

    Attributes:
        q, v: Of the joints in ``qpos`` and in ``qvel``, shape (29,) each.
        u: Of their position actuators in ``ctrl``, shape (29,).
        root_q: Of the root's position and quaternion wxyz in ``qpos``, shape (7,).
        root_v: Of its linear (world frame) and angular (body frame) velocity in ``qvel``, shape (6,).
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        joints = [model.joint(joint.mjcf_name) for joint in select(G1_29)]
        self.q = np.array([joint.qposadr[0] for joint in joints])
        self.v = np.array([joint.dofadr[0] for joint in joints])
        actuator_of = {int(model.actuator_trnid[u, 0]): u for u in range(model.nu)}
        self.u = np.array([actuator_of[joint.id] for joint in joints])
        free = model.body(mjcf.ROOT_BODY).jntadr[0]
        self.root_q = np.arange(7) + model.jnt_qposadr[free]
        self.root_v = np.arange(6) + model.jnt_dofadr[free]
