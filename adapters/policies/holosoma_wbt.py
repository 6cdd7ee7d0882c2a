"""Holosoma's whole-body tracking of the 29-joint G1, FastSAC and PPO: ONNX, 154 numbers in, 29 joint offsets out.

Observation: 0 previous output (29) · 29 gyro (3) · 32 q - default (29) · 61 dq (29) · 90 joint positions of the
reference (29) · 119 their velocities (29) · 148 orientation of the reference's torso in the robot's torso, the first
two columns of the matrix, row by row (6). Behind them stand two numbers that the network does not see and the next step
needs, so that a recording has all that decides: heading and pitch of the reference's root [rad].

It follows TWIST2's commands. They have neither velocities of joints nor a heading: velocities are differences of
commands, and the heading is the sum of their yaw rates, from where the robot's torso looked when the policy began; it
stays within 0.6 rad of the robot's.
Velocity and height of the root are not used. Wire facts: PyPI ``holosoma-inference`` 0.1.3, ``policies/wbt.py`` and
``policies/wbt_utils.py``.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.policies.follower import LastOutput, joined
from adapters.policies.heading import rate, within_reach
from adapters.policies.holosoma import DEFAULT_Q, gains_of
from adapters.policies.onnx_network import OnnxNetwork
from adapters.robots.g1.joints import G1_29, WAIST
from adapters.robots.g1.kinematics import about, matrix
from station.assets import sha256
from station.errors import BadFile
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState

OBSERVATION, STEP_S = 154, 0.02
_ROLL, _PITCH, _YAW_RATE, _JOINTS = 3, 4, 5, 6  # places in the command
_JOINTS_SEEN = slice(90, 119)
_WAIST = [G1_29.index(name) for name in WAIST]


class HolosomaTrackingPolicy(LastOutput):
    """Implements `station.protocols.Policy`.

    Args:
        checkpoint: The network's file.

    Raises:
        BadFile: missing, no such network, or for other joints.
    """

    ORIGIN = "the PyPI wheel holosoma-inference 0.1.3, models/wbt/{fastsac,ppo}_g1_29dof_dancing.onnx"

    def __init__(self, checkpoint: Path) -> None:
        path = Path(checkpoint)
        network = OnnxNetwork(
            path, inputs=OBSERVATION, outputs=len(G1_29), named=("obs", "actions"),
            beside={"time_step": np.zeros((1, 1), np.float32)},
        )  # fmt: skip
        kp, kd = gains_of(network, path)
        self._network = lambda observation: network(observation[:OBSERVATION])
        self._scale = _scale(network, path, kp)
        self._spec = PolicySpec(
            name="holosoma-wbt", checkpoint=path, sha256=sha256(path), runtime=network.runtime, rate_hz=1 / STEP_S,
            command=FORMAT.name, joint_names=G1_29, default_q=DEFAULT_Q, kp=kp, kd=kd,
            observation_size=OBSERVATION + 2, action_size=len(G1_29),
        )  # fmt: skip
        self.reset()

    def reset(self) -> None:
        """Forget the previous output and the reference: the heading begins where the robot looks."""
        super().reset()
        self._seen: tuple[Floats, float, float] | None = None  # joints, pitch and heading of the reference before

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (156,), of the state of the 29 joints and a command of TWIST2, shape (35,)."""
        roll, pitch, yaw_rate = command[[_ROLL, _PITCH, _YAW_RATE]].tolist()
        joints: Floats = command[_JOINTS:].astype(np.float32).astype(np.float64)  # as a recording has them
        robot = matrix(state.quat_wxyz) @ _torso(state.q)
        lean = about("y", np.array(pitch)) @ about("x", np.array(roll))
        asked = lean @ _torso(joints)
        before = self._seen
        looks = _heading(robot) - _heading(asked)  # the heading of the reference with which both torsos look one way
        velocity, heading = np.zeros_like(joints), looks
        if before is not None:
            velocity = (joints - before[0]) / STEP_S
            heading = before[2] + float(rate(roll, pitch, (pitch - before[1]) / STEP_S, yaw_rate)) * STEP_S
        heading, pitch = within_reach(heading, looks), float(np.float32(pitch))
        self._seen = joints, pitch, heading
        seen = robot.T @ about("z", np.array(heading)) @ asked
        return joined(
            self._previous(), state.gyro, state.q - DEFAULT_Q, state.dq, joints, velocity, seen[:, :2].ravel(),
            [heading, pitch],
        )  # fmt: skip

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + scale x output; nothing of the command bypasses the network."""
        return JointTargets(DEFAULT_Q + self._scale * action.astype(np.float64), self._spec.kp, self._spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Restore previous output and reference from a recorded observation, shape (156,)."""
        super().restore(observation)
        heading, pitch = observation[OBSERVATION:].tolist()
        self._seen = observation[_JOINTS_SEEN].astype(np.float64), pitch, heading


def _scale(network: OnnxNetwork, path: Path, kp: Floats) -> Floats:
    """Return radians per unit of output, shape (29,): 1 where the file holds no training configuration (FastSAC)."""
    text = network.metadata.get("experiment_config")
    if text is None:
        return np.ones_like(kp)
    try:
        robot = json.loads(text)["robot"]
        control = robot["control"]
        scale = np.full_like(kp, float(control["action_scale"]))
        if control["action_scales_by_effort_limit_over_p_gain"]:
            scale *= np.array(robot["dof_effort_limit_list"], np.float64) / kp
    except (ValueError, KeyError, TypeError):
        raise BadFile(
            f"{path}: its experiment_config does not say how actions are scaled; expected robot.control.action_scale, "
            f"action_scales_by_effort_limit_over_p_gain and {len(kp)} numbers in robot.dof_effort_limit_list"
        ) from None
    return scale


def _torso(q: Floats) -> Floats:
    """Return the rotation from torso to root, shape (3, 3), of the 29 joint positions."""
    yaw, roll, pitch = q[_WAIST]
    return np.asarray(about("z", yaw) @ about("x", roll) @ about("y", pitch))


def _heading(rotation: Floats) -> float:
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))
