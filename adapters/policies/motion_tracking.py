"""The G1's policy of motion_tracking (after GentleHumanoid): ONNX, 623 numbers in, 29 joint offsets out.

It sees where the reference is in 0, 2, 4, 8 and 16 steps. Commands say where it is now, so the policy keeps them for 16
steps and **does what is commanded 0.32 s later**. Observation, F being those steps, joints in Isaac Lab's order:

| index | numbers | what |
|---|---|---|
| 0 | 1 | boot indicator, 0 |
| 1 | 12 | position of the reference's root at F[1:] less that at F[0], in the reference's root frame at F[0] [m] |
| 13 | 30 | orientation of the reference's root at F in the robot's, the first column of the matrix, then the second |
| 43 | 3 | compliance: whether it gives way, at which force, and that over 0.05 |
| 46 | 290 | joint positions of the reference at F, then those less the robot's [rad] |
| 336 | 5 | height of the reference's root at F + 0.035 [m] |
| 341 | 15 | down in the reference's root frame at F |
| 356 | 6 | gyro [rad/s]; down in the robot's frame |
| 362 | 174 | joint positions of the robot 0, 1, 2, 3, 4 and 8 steps ago [rad] |
| 536 | 87 | outputs of the last three steps, clipped, the newest first |

Behind them stands what the network does not see and the next step needs, so that a recording has all that decides: the
17 newest commands, the heading of the reference at F[0] [rad], and joint positions 5, 6 and 7 steps ago.

It follows TWIST2's commands. They have neither a place nor a heading: the place is the sum of their velocities, the
heading that of their yaw rates, from where the robot looked when the policy began (`adapters.policies.heading`).

Wire facts: Axellwppr/motion_tracking, deployment of commit e107c6f; gains and limits of the motors as in mjlab. Its
network cannot be had, so it has not walked here; the later generation of commit 0d5ba31 sees other numbers.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.policies.follower import LastOutput, gravity, joined
from adapters.policies.heading import rate, within_reach
from adapters.policies.history import FrameHistory
from adapters.policies.onnx_network import OnnxNetwork, open_session
from adapters.robots.g1.joints import FROM_ISAAC, G1_29, JOINTS, TO_ISAAC
from adapters.robots.g1.kinematics import about, matrix
from station.assets import sha256
from station.errors import BadFile, ConfigError
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState
from station.rotations import roll_pitch_yaw

STEP_S = 0.02
AHEAD = (0, 2, 4, 8, 16)
"""Steps."""
SEEN, COMMANDS = 623, AHEAD[-1] + 1
_JOINTS_AGO, _REMEMBERED_AGO = [0, 1, 2, 3, 4, 8], [5, 6, 7]
_OUTPUTS = 3
_JOINTS_AT, _OUTPUTS_AT = 362, 536
_HEADING = COMMANDS * len(FORMAT.elements)  # behind what the network sees
_JOINTS = slice(6, None)  # of a command

_LEG = (-0.28, 0.0, 0.0, 0.5, -0.23, 0.0)
_ARM, _OTHER_ARM = ((0.35, roll, 0.0, 0.87, 0.0, 0.0, 0.0) for roll in (0.16, -0.16))
DEFAULT_Q: Floats = np.array([*_LEG, *_LEG, 0.0, 0.0, 0.0, *_ARM, *_OTHER_ARM])
"""Joint positions at action zero, in the order of `G1_29` [rad]."""
_SCALE = np.array([1.0 if any(part in name for part in ("shoulder", "elbow", "wrist")) else 0.5 for name in G1_29])
_CLIP = 10.0
_SOFTNESS_HZ, _DAMPING = 10.0, 2.0  # a joint is a spring about its rotor
_HIGHER_M = 0.035
_STIFFEST = 0.05  # [m], by which the force is divided
_FORCES = (10.0, 20.0)


class MotionTrackingPolicy(LastOutput):
    """Implements `station.protocols.Policy`.

    Args:
        checkpoint: The network's file; beside it may stand what its exporter says of its outputs, ``.json``.
        compliance_n: At which force it gives way, 10 to 20 [N]; 0: it does not.

    Raises:
        BadFile: missing, or no such network.
        ConfigError: another force.
    """

    ORIGIN = (
        "Axellwppr/motion_tracking on GitHub (no licence declared), exported by its training: a .onnx and its .json"
    )

    def __init__(self, checkpoint: Path, *, compliance_n: float = 0.0) -> None:
        path = Path(checkpoint)
        if compliance_n and not _FORCES[0] <= compliance_n <= _FORCES[1]:
            raise ConfigError(f"compliance_n {compliance_n:g}: expected 0, or 10 to 20 N")
        network = OnnxNetwork(path, inputs=SEEN, outputs=len(G1_29), named=("", _output(path)))
        self._network = lambda observation: network(observation[:SEEN])
        armature, turns = np.array([joint.armature for joint in JOINTS]), 2.0 * np.pi * _SOFTNESS_HZ
        self._spec = PolicySpec(
            name="motion-tracking", checkpoint=path, sha256=sha256(path), runtime=network.runtime, rate_hz=1 / STEP_S,
            command=FORMAT.name, joint_names=G1_29, default_q=DEFAULT_Q, kp=armature * turns**2,
            kd=2.0 * _DAMPING * armature * turns,
            observation_size=SEEN + _HEADING + 1 + len(_REMEMBERED_AGO) * len(G1_29),
            action_size=len(G1_29),
        )  # fmt: skip
        self._compliance = [1.0, compliance_n, compliance_n / _STIFFEST] if compliance_n else [0.0, 0.0, 0.0]
        self._commands = FrameHistory(COMMANDS, len(FORMAT.elements))
        self._joints = FrameHistory(_JOINTS_AGO[-1] + 1, len(G1_29))
        self._outputs = FrameHistory(_OUTPUTS, len(G1_29))
        self.reset()

    def reset(self) -> None:
        """Forget outputs, commands and joints: the first of the latter two count as if they had always been."""
        super().reset()
        self._outputs.clear()
        self._heading: float | None = None  # of the reference now [rad]

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (1306,), of the state of the 29 joints and a command of TWIST2, shape (35,)."""
        given, q = command.astype(np.float32), state.q[TO_ISAAC].astype(np.float32)
        looks = float(roll_pitch_yaw(state.quat_wxyz)[2])
        if self._heading is None:
            self._commands.fill(np.tile(given, COMMANDS))
            self._joints.fill(np.tile(q, _JOINTS_AGO[-1] + 1))
            self._heading = looks
        else:
            self._heading += STEP_S * float(_turns(self._commands.rows[:2].astype(np.float64))[1])
            self._commands.push(given)
            self._joints.push(q)
        self._heading = within_reach(self._heading, looks)
        self._outputs.push(np.clip(self._previous(), -_CLIP, _CLIP))
        position, rotation, joints = _reference(self._commands.rows.astype(np.float64), self._heading)
        seen, ago = matrix(state.quat_wxyz).T @ rotation, self._joints.rows[::-1]
        return joined(
            [0.0], ((position[1:] - position[0]) @ rotation[0]).ravel(), seen[..., :2].swapaxes(1, 2).ravel(),
            self._compliance, joints.ravel(), (joints - q).ravel(), position[:, 2] + _HIGHER_M, -rotation[:, 2].ravel(),
            state.gyro, gravity(state), ago[_JOINTS_AGO].ravel(), self._outputs.rows[::-1].ravel(),
            self._commands.flat, [self._heading], ago[_REMEMBERED_AGO].ravel(),
        )  # fmt: skip

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + scale x the clipped output; nothing of the command bypasses the network."""
        offsets = np.clip(action.astype(np.float64), -_CLIP, _CLIP)[FROM_ISAAC]
        return JointTargets(DEFAULT_Q + _SCALE * offsets, self._spec.kp, self._spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Restore outputs, commands, heading and joints from a recorded observation, shape (1306,)."""
        super().restore(observation)
        seen, (commands, heading, remembered) = (
            observation[:SEEN],
            np.split(observation[SEEN:], [_HEADING, _HEADING + 1]),
        )
        self._commands.fill(commands)
        self._heading = float(heading[0])
        ago = np.empty_like(self._joints.rows)
        ago[_JOINTS_AGO] = seen[_JOINTS_AT:_OUTPUTS_AT].reshape(-1, len(G1_29))
        ago[_REMEMBERED_AGO] = remembered.reshape(-1, len(G1_29))
        self._joints.fill(ago[::-1])
        self._outputs.fill(seen[_OUTPUTS_AT:].reshape(_OUTPUTS, -1)[::-1])


def _reference(commands: Floats, heading: float) -> tuple[Floats, Floats, Floats]:
    """Return where the reference is in `AHEAD` steps: position (5, 3) [m], rotation (5, 3, 3), joints (5, 29) [rad].

    Args:
        commands: The oldest first, which is where it is now, shape (17, 35).
        heading: Of the first [rad].
    """
    height, roll, pitch = commands[:, 2], commands[:, 3], commands[:, 4]
    lean = about("y", pitch) @ about("x", roll)
    rotation = about("z", heading + STEP_S * np.cumsum(_turns(commands))) @ lean
    # How fast it climbs follows from its heights; so how fast it goes along its own axis that points up.
    climbs = np.diff(height, prepend=height[0]) / STEP_S
    up = (climbs - (lean[:, 2, :2] * commands[:, :2]).sum(axis=1)) / lean[:, 2, 2]
    velocity = (rotation @ np.column_stack([commands[:, :2], up])[..., None])[..., 0]
    position = STEP_S * (np.cumsum(velocity, axis=0) - velocity[0])
    position[:, 2] = height
    ahead = list(AHEAD)
    return position[ahead], rotation[ahead], commands[ahead][:, _JOINTS][:, TO_ISAAC]


def _turns(commands: Floats) -> Floats:
    """Return how fast the heading changes up to each command [rad/s], 0 up to the first, shape (n,)."""
    pitching = np.diff(commands[:, 4], prepend=commands[0, 4]) / STEP_S
    turns = rate(commands[:, 3], commands[:, 4], pitching, commands[:, 5])
    turns[0] = 0.0
    return turns


def _output(path: Path) -> str:
    """Return what the network calls its action: its exporter says which of its outputs that is.

    Raises:
        BadFile: what the exporter says is no list of names with ``action`` in it, or of more than there are.
    """
    names, listed = [str(port.name) for port in open_session(path).get_outputs()], path.with_suffix(".json")
    if not listed.is_file():
        return "action" if "action" in names else ""
    try:
        return names[int(json.loads(listed.read_bytes())["out_keys"].index("action"))]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise BadFile(
            f"{listed}: does not say which of the {len(names)} outputs of {path.name} is the action; expected a list "
            "out_keys with it"
        ) from None
