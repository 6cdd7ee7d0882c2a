"""The bare loop that policies of others were verified in: a model of theirs, PD torques, no station."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from station.protocols import Floats, Policy, RobotState
from station.rotations import roll_pitch_yaw, rotate_inverse, tilt

CONTROL_DT_S = 0.02
SETTLES_S = 1.5
_FALLEN_RAD = 1.0


class BareLoop:
    """A policy and a model with a free base, whose joints are in the policy's order.

    Args:
        policy: Follows velocities.
        model: MJCF whose joints are called as the policy's, with ``_joint`` behind.
        effort: Greatest torque of each joint [N m].
        height_m: Of the base at the start.
        physics_dt_s: Physics step [s].
        armature: Rotor inertia in place of the model's [kg m^2]; None for the model's.
        has_servos: Whether the model's own servos hold the targets; else torques are computed in each physics step.
    """

    def __init__(
        self, policy: Policy, model: Path, *, effort: Floats | float, height_m: float,
        physics_dt_s: float = 0.002, armature: float | None = None, has_servos: bool = False,
    ) -> None:  # fmt: skip
        self.policy, self._effort, self._has_servos = policy, effort, has_servos
        self._model = mujoco.MjModel.from_xml_path(str(model))
        self._model.opt.timestep = physics_dt_s
        joints = [self._model.joint(f"{name}_joint") for name in policy.spec.joint_names]
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._v = np.array([joint.dofadr[0] for joint in joints])
        if armature is not None:
            self._model.dof_armature[self._v] = armature
        self._steps = round(CONTROL_DT_S / physics_dt_s)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:7] = 0.0, 0.0, height_m, 1.0, 0.0, 0.0, 0.0
        self._data.qpos[self._q] = policy.spec.default_q
        mujoco.mj_forward(self._model, self._data)

    def state(self) -> RobotState:
        """Return what a robot would measure."""
        quat, moves = self._data.qpos[3:7].copy(), self._data.qvel[:6].copy()
        return RobotState(
            mono_ns=0, q=self._data.qpos[self._q].copy(), dq=self._data.qvel[self._v].copy(), quat_wxyz=quat,
            gyro=moves[3:], root_pos=self._data.qpos[:3].copy(), root_lin_vel=rotate_inverse(quat, moves[:3]),
        )  # fmt: skip

    def walk(self, commands: Sequence[tuple[float, float, float]], seconds: float) -> list[Floats]:
        """Give each command for some time; return the mean velocity of each in the heading frame, after it settled.

        Raises:
            AssertionError: the robot fell.
        """
        measured = []
        for command in commands:
            rows = []
            for _ in range(round(seconds / CONTROL_DT_S)):
                before = self.state()
                self._step(before, np.array(command))
                rows.append(_velocity(before, self.state()))
                assert tilt(self._data.qpos[3:7]) < _FALLEN_RAD, f"fell while commanded {command}"
            measured.append(np.mean(rows[round(SETTLES_S / CONTROL_DT_S) :], axis=0))
        return measured

    def _step(self, state: RobotState, command: Floats) -> None:
        action = self.policy.act(self.policy.observe(state, command))
        targets = self.policy.targets(action, command)
        for _ in range(self._steps):
            if self._has_servos:
                self._data.ctrl[:] = targets.q
            else:
                torque = targets.kp * (targets.q - self._data.qpos[self._q]) - targets.kd * self._data.qvel[self._v]
                self._data.qfrc_applied[self._v] = np.clip(torque, -np.asarray(self._effort), self._effort)
            mujoco.mj_step(self._model, self._data)


def _velocity(before: RobotState, after: RobotState) -> Floats:
    assert before.root_pos is not None
    assert after.root_pos is not None
    yaws = roll_pitch_yaw(np.stack([before.quat_wxyz, after.quat_wxyz]))[:, 2]
    turned = (yaws[1] - yaws[0] + np.pi) % (2 * np.pi) - np.pi
    x, y, _ = (after.root_pos - before.root_pos) / CONTROL_DT_S
    cosine, sine = np.cos(yaws[0]), np.sin(yaws[0])
    return np.array([x * cosine + y * sine, y * cosine - x * sine, turned / CONTROL_DT_S])
