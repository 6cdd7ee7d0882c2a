"""What policies that follow velocities share: a network that sees its own last output, and targets about a pose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from adapters.commands.velocity import FORMAT
from adapters.policies.history import FrameHistory
from adapters.policies.onnx_network import OnnxNetwork
from station.assets import sha256
from station.protocols import CommandFormat, Floats, Floats32, JointTargets, PolicySpec, RobotState
from station.rotations import rotate_inverse

ACTION_CLIP = 100.0
_DOWN = np.array([0.0, 0.0, -1.0])


class HasOrientation(Protocol):
    """The state of a robot, or of many at once."""

    @property
    def quat_wxyz(self) -> Floats:
        """Orientation of the root in the world, shape (..., 4)."""
        ...


class Loaded(NamedTuple):
    """A network, what runs it, and stiffness and damping of the joints."""

    network: Callable[[Floats32], Floats32]
    runtime: str
    gains: tuple[Floats, Floats]


class LastOutput:
    """What a policy is whose network sees its own last output: `station.protocols.Policy` but for `observe`.

    Attributes:
        _network: Of one float32 row, shape (observation_size,), the raw output, shape (action_size,).
        _spec: The constants.
    """

    _network: Callable[[Floats32], Floats32]
    _spec: PolicySpec

    @property
    def spec(self) -> PolicySpec:
        """The constants of this policy."""
        return self._spec

    def reset(self) -> None:
        """Forget the previous output: zero."""
        self._action: Floats32 = np.zeros(self._spec.action_size, dtype=np.float32)
        self._restored: Floats32 | None = None

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network, shape (action_size,), before clipping."""
        self._action = self._network(observation)
        self._restored = None
        return self._action

    def restore(self, observation: Floats32) -> None:
        """Restore what a recorded observation shows; the output of its step is inferred, unless `act` is called."""
        self._restored = np.array(observation, dtype=np.float32)

    def _previous(self) -> Floats32:
        """Return the raw output of the step before, shape (action_size,)."""
        if self._restored is not None:
            self.act(self._restored)
        return self._action


class VelocityFollower(LastOutput):
    """A policy of a family that is the same but for `observe`.

    The arithmetic, so that an audit can repeat it bit for bit: observations in float64, each number rounded once to
    float32; the network in float32; targets in float64.

    Args:
        checkpoint: The network's file.

    Raises:
        BadFile: missing, no such network, or not of this family's sizes.
    """

    NAME: ClassVar[str]
    ORIGIN: ClassVar[str]
    """Where the file comes from, for whoever lacks it."""
    JOINTS: ClassVar[tuple[str, ...]]
    DEFAULT_Q: ClassVar[Floats]
    """Joint positions at action zero, in the order of `JOINTS` [rad]."""
    GAINS: ClassVar[tuple[Floats, Floats]]
    """Stiffness and damping of each joint [N m/rad, N m s/rad]."""
    SCALE: ClassVar[float]
    """Radians per unit of output."""
    OBSERVATION: ClassVar[int]
    RANGE: ClassVar[tuple[tuple[float, float], ...]]
    """What it was trained on, of each element of its command: vx, vy [m/s], yaw rate [rad/s], …"""
    COMMAND: ClassVar[CommandFormat] = FORMAT
    ACTIONS: ClassVar[int] = 0
    """Numbers of its output; 0 for one per joint."""
    NEEDS_ROOT_VELOCITY: ClassVar[bool] = False

    def __init__(self, checkpoint: Path) -> None:
        path = Path(checkpoint)
        self._network, runtime, (kp, kd) = self._load(path)
        lower, upper = np.array(self.RANGE).T
        self._spec = PolicySpec(
            name=self.NAME, checkpoint=path, sha256=sha256(path), runtime=runtime, rate_hz=50.0,
            command=self.COMMAND.name, joint_names=self.JOINTS, default_q=self.DEFAULT_Q, kp=kp, kd=kd,
            observation_size=self.OBSERVATION, action_size=self.ACTIONS or len(self.JOINTS),
            command_lower=lower, command_upper=upper, needs_root_velocity=self.NEEDS_ROOT_VELOCITY,
        )  # fmt: skip
        self.reset()

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + scale x the clipped output; nothing of the command bypasses the network."""
        return JointTargets(self._spec.default_q + self.SCALE * clipped(action), self._spec.kp, self._spec.kd)

    def _load(self, path: Path) -> Loaded:
        """Return the network, what runs it, and the gains."""
        network = OnnxNetwork(path, inputs=self.OBSERVATION, outputs=self.ACTIONS or len(self.JOINTS))
        return Loaded(network, network.runtime, self.GAINS)


class FramedFollower(VelocityFollower):
    """A follower that sees its last frames, and drives the first joints of its robot; the others are held."""

    FRAMES: ClassVar[int] = 6
    FRAME: ClassVar[int]
    """Numbers in a frame."""

    def reset(self) -> None:
        """Forget the frames and the previous output: zero."""
        super().reset()
        self._frames = FrameHistory(self.FRAMES, self.FRAME)

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, of the state of all joints and a command."""
        self._frames.push(self._frame(state, command, clipped(self._previous())))
        return self._frames.flat.copy()

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + scale x the clipped output of the joints that it drives, and the default of the others."""
        q = self.DEFAULT_Q.copy()
        q[: len(action)] += self.SCALE * clipped(action)
        return JointTargets(q, self._spec.kp, self._spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Restore frames and previous output from a recorded observation."""
        super().restore(observation)
        self._frames.fill(self._restored if self._restored is not None else observation)

    def _frame(self, state: RobotState, command: Floats, previous: Floats) -> Floats32:
        raise NotImplementedError


def clipped(action: Floats32) -> Floats:
    """Return a raw output within what training allowed."""
    return np.clip(action.astype(np.float64), -ACTION_CLIP, ACTION_CLIP)


def gravity(state: HasOrientation) -> Floats:
    """Return where down is in the root frame, shape (..., 3); ``0 0 -1`` for a robot that is upright."""
    return rotate_inverse(state.quat_wxyz, _DOWN)


def joined(*parts: Floats | Floats32 | list[float]) -> Floats32:
    """Return the parts of an observation as one, shape (observation_size,)."""
    return np.concatenate(parts).astype(np.float32)
