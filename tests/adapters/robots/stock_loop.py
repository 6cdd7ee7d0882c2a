"""The PD law as upstream scripts run it in Python, for a comparison with the engine's servo."""

from __future__ import annotations

from copy import copy
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from adapters.robots.legged import mjcf
from adapters.robots.legged.mujoco_robot import LeggedMujoco
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import G1, ROBOTS
from station.protocols import JointTargets


@cache
def _explicit(name: str, path: Path) -> mujoco.MjModel:
    """The model as upstream scripts use it: torque motors, driven from outside."""
    spec = mujoco.MjSpec.from_file(str(path))
    mjcf.prepare(spec, ROBOTS.get(name, G1))
    for actuator in spec.actuators:
        actuator.gainprm[0] = 1.0
        actuator.biastype = mujoco.mjtBias.mjBIAS_NONE
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    return spec.compile()


class StockLoop:
    """One torque per physics step, computed and clipped outside the engine."""

    def __init__(self, robot: LeggedRobot, path: Path, follows: LeggedMujoco, physics_dt_s: float) -> None:
        self.model = copy(_explicit(robot.name, path))
        self.model.opt.timestep = physics_dt_s
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(joint.mjcf_name) for joint in robot.joints]
        self.q_at, self.v_at = [j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]
        motor_of = {int(self.model.actuator_trnid[u, 0]): u for u in range(self.model.nu)}
        self.motors = [motor_of[j.id] for j in joints]
        self.limit = np.array(robot.torques_nm)
        self.steps = round(0.02 / physics_dt_s)
        self.clipped = 0
        self.follow(follows)

    def follow(self, robot: LeggedMujoco) -> None:
        """Take up the other's state, the solver's starting guess included."""
        self.data.qpos[:], self.data.qvel[:] = robot._data.qpos, robot._data.qvel
        self.data.qacc_warmstart[:] = robot._data.qacc_warmstart

    def write(self, targets: JointTargets) -> None:
        for _ in range(self.steps):
            torque = targets.kp * (targets.q - self.data.qpos[self.q_at]) - targets.kd * self.data.qvel[self.v_at]
            self.clipped += int((np.abs(torque) > self.limit).sum())
            self.data.ctrl[self.motors] = np.clip(torque, -self.limit, self.limit)
            mujoco.mj_step(self.model, self.data)

    def assert_equals(self, robot: LeggedMujoco) -> None:
        state = robot.read()
        np.testing.assert_allclose(state.q, self.data.qpos[self.q_at], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.dq, self.data.qvel[self.v_at], rtol=0, atol=1e-9)
