"""pilla_rl_ros' walking policy of the H1 with 19 joints: TorchScript, 69 numbers in, 19 joint offsets out.

Observation: 0 velocity of the base (3) · 3 gyro (3) · 6 gravity (3) · 9 vx, vy, yaw rate of the command (3) · 12
q - default (19) · 31 dq (19) · 50 previous output (19). Nothing is scaled or clipped. The network has its joints in
Isaac Lab's order, level by level from the base on, left before right; the robot in that of its model. Wire facts:
code-name-57/pilla_rl_ros, ``h1fullbodyNode.py``. Gains and the range of the commands do not stand there: they are
those of the task ``Isaac-Velocity-Flat-H1-v0`` that such policies are trained on (isaac-sim/IsaacLab,
``isaaclab_assets/robots/unitree.py``, ``velocity/config/h1``). Its file cannot be had, so it has not walked here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.policies.follower import Loaded, VelocityFollower, gravity, joined
from adapters.policies.torchscript_network import TorchScriptNetwork
from station.protocols import Floats, Floats32, JointTargets, RobotState


def _both(*names: str) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for side in ("left", "right") for name in names)


_LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
_JOINTS = (*_both(*_LEG), "torso", *_both(*_ARM))
_ISAAC = (
    *_both("hip_yaw"), "torso", *_both("hip_roll"), *_both("shoulder_pitch"), *_both("hip_pitch"),
    *_both("shoulder_roll"), *_both("knee"), *_both("shoulder_yaw"), *_both("ankle"), *_both("elbow"),
)  # fmt: skip
_TO_ISAAC = [_JOINTS.index(name) for name in _ISAAC]
_FROM_ISAAC = [_ISAAC.index(name) for name in _JOINTS]


class PillaH1Policy(VelocityFollower):
    """Implements `station.protocols.Policy`."""

    NAME = "pilla-h1"
    ORIGIN = "nowhere: code-name-57/pilla_rl_ros on GitHub expects a policy/h1_policy.pt of your own training"
    JOINTS = _JOINTS
    DEFAULT_Q = np.array([*[0, 0, -0.28, 0.79, -0.52] * 2, 0, *[0.28, 0, 0, 0.52] * 2], dtype=np.float64)
    GAINS = (
        np.array([*[150.0, 150, 200, 200, 20] * 2, 200, *[40.0] * 8]),
        np.array([*[5.0, 5, 5, 5, 4] * 2, 5, *[10.0] * 8]),
    )
    SCALE, OBSERVATION = 0.5, 69
    RANGE = ((0.0, 1.0), (0.0, 0.0), (-1.0, 1.0))
    NEEDS_ROOT_VELOCITY = True

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (69,), of the state of the 19 joints and a velocity, shape (3,)."""
        assert state.root_lin_vel is not None, "the rig gives it no robot that does not measure it"
        return joined(
            state.root_lin_vel, state.gyro, gravity(state), command, (state.q - self.DEFAULT_Q)[_TO_ISAAC],
            state.dq[_TO_ISAAC], self._previous(),
        )  # fmt: skip

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + 0.5 x the output, which is in Isaac Lab's order."""
        return super().targets(action[_FROM_ISAAC], command)

    def _load(self, path: Path) -> Loaded:
        network = TorchScriptNetwork(path, inputs=self.OBSERVATION, outputs=len(self.JOINTS))
        return Loaded(network, network.runtime, self.GAINS)
