"""Policies that follow velocities, as unitree_rl_lab and unitree_rl_mjlab export them: a ``deploy.yaml`` and a network.

The page says all that differs between robots and policies: the terms of an observation in their order, clip and scale
of each, how many steps of it the network sees (per term, oldest first), scale and offset of the targets, stiffness and
damping, the range of velocities. ``joint_ids_map`` has the motor of each of the network's joints: stiffness and damping
stand by motor, all else in the network's order. What the joints are called the page does not say: a row of
`adapters.robots.legged.unitree` does. After a reset every step of a term is the first one.

Wire facts: unitreerobotics/unitree_rl_lab, ``deploy/include/isaaclab``, and the pages of two policies of a G1, which
walk in a loop that is not ours.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from adapters.commands.velocity import FORMAT
from adapters.policies.follower import LastOutput, gravity
from adapters.policies.history import FrameHistory
from adapters.policies.onnx_network import OnnxNetwork
from adapters.robots.g1.joints import G1_29
from adapters.robots.legged.unitree import ROBOTS
from station import safe_yaml
from station.assets import sha256
from station.errors import BadFile, ConfigError, did_you_mean
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState

MOTORS: dict[str, dict[str, int]] = {
    "g1_29": {name: motor for motor, name in enumerate(G1_29)},
    **{name: dict(zip(robot.joint_names, robot.motors, strict=True)) for name, robot in ROBOTS.items()},
}
"""By robot: its joints, in their order, and the motor of each. Where no robot is named, the first one that fits."""
NETWORKS = ("policy.onnx", "{page}.onnx", "../exported/policy.onnx")
"""Where the network is, from the folder of its page."""
_ALL_JOINTS = "!!python/object/apply:builtins.slice"  # taken for the list behind it: nothing of a page is ever called


class _Seen(NamedTuple):
    """What an observation is made of; joints in the network's order, positions from the default ones."""

    state: RobotState
    command: Floats
    q: Floats
    dq: Floats
    previous: Floats32


_TERMS: dict[str, Callable[[_Seen], Floats]] = {
    "base_ang_vel": lambda seen: seen.state.gyro,
    "projected_gravity": lambda seen: gravity(seen.state),
    "velocity_commands": lambda seen: seen.command,
    "joint_pos_rel": lambda seen: seen.q,
    "joint_vel_rel": lambda seen: seen.dq,
    "last_action": lambda seen: seen.previous.astype(np.float64),
}
_OF_JOINTS = ("joint_pos_rel", "joint_vel_rel", "last_action")

_Span = tuple[float, float]


class _Term(msgspec.Struct):
    scale: list[float] | None = None
    clip: _Span | None = None
    history_length: Annotated[int, msgspec.Meta(ge=0, le=100)] = 1


class _Action(msgspec.Struct):
    scale: list[float] | None = None
    offset: list[float] | None = None
    clip: list[_Span] | None = None
    joint_ids: list[int | None] | None = None


class _Actions(msgspec.Struct, forbid_unknown_fields=True):
    JointPositionAction: _Action


class _Ranges(msgspec.Struct):
    lin_vel_x: _Span
    lin_vel_y: _Span
    ang_vel_z: _Span


class _Velocity(msgspec.Struct):
    ranges: _Ranges


class _Commands(msgspec.Struct):
    base_velocity: _Velocity


class _Page(msgspec.Struct):
    joint_ids_map: Annotated[list[int], msgspec.Meta(min_length=1)]
    step_dt: Annotated[float, msgspec.Meta(gt=0)]
    stiffness: list[float]
    damping: list[float]
    default_joint_pos: list[float]
    commands: _Commands
    actions: _Actions
    observations: dict[str, _Term]


class _Part(NamedTuple):
    """A term: what it is of, its clip, its scale, and the steps that the network sees."""

    of: Callable[[_Seen], Floats]
    clip: _Span
    scale: Floats
    steps: FrameHistory


class DeployYamlPolicy(LastOutput):
    """Implements `station.protocols.Policy`.

    Args:
        checkpoint: The page.
        robot: Whose motors they are, for example ``go1``; "" for the first of G1, Go2, … that has them.

    Raises:
        BadFile: page or network is missing, or asks for what is not known here.
        ConfigError: no robot has these motors, or not the one that is named.
    """

    ORIGIN = "unitreerobotics/unitree_rl_lab or unitree_rl_mjlab on GitHub: a deploy.yaml with policy.onnx beside it"

    def __init__(self, checkpoint: Path, *, robot: str = "") -> None:
        path = Path(checkpoint)
        page = _read(path)
        motors = _motors(path, page.joint_ids_map, robot)
        count = len(motors)
        values = _Values(path, count)
        self._joints = np.array([list(motors.values()).index(motor) for motor in page.joint_ids_map])
        self._default = values.each("default_joint_pos", page.default_joint_pos)
        self._scale, self._offset, self._clip = values.action(page.actions.JointPositionAction)
        self._parts = [values.part(name, term) for name, term in page.observations.items()]
        inputs = sum(part.steps.flat.size for part in self._parts)
        file = _network(path)
        self._network = network = OnnxNetwork(file, inputs=inputs, outputs=count)
        slots, each_motor = max(motors.values()) + 1, list(motors.values())
        gains = [values.each(name, getattr(page, name), count=slots)[each_motor] for name in ("stiffness", "damping")]
        span = page.commands.base_velocity.ranges
        lower, upper = np.sort([span.lin_vel_x, span.lin_vel_y, span.ang_vel_z]).T
        self._spec = PolicySpec(
            name="deploy-yaml", checkpoint=path, sha256=_sha256(path, file), runtime=network.runtime,
            rate_hz=1.0 / page.step_dt, command=FORMAT.name, joint_names=tuple(motors),
            default_q=self._of_robot(self._default), kp=gains[0], kd=gains[1], observation_size=inputs,
            action_size=count, command_lower=lower, command_upper=upper,
        )  # fmt: skip
        self.reset()

    def reset(self) -> None:
        """Forget the previous output and all steps."""
        super().reset()
        self._is_first = True

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of a state and a velocity, shape (3,)."""
        q, dq = state.q[self._joints] - self._default, state.dq[self._joints]
        seen = _Seen(state, command, q, dq, self._previous())
        for of, clip, scale, steps in self._parts:
            frame = (np.clip(of(seen), *clip) * scale).astype(np.float32)
            if self._is_first:
                steps.fill(np.tile(frame, steps.flat.size // frame.size))
            else:
                steps.push(frame)
        self._is_first = False
        return np.concatenate([part.steps.flat for part in self._parts])

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return scale x output + offset, clipped where the page says so."""
        q = np.clip(action.astype(np.float64) * self._scale + self._offset, *self._clip)
        return JointTargets(self._of_robot(q), self._spec.kp, self._spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Restore all steps from a recorded observation; the output of its step is inferred, unless `act` is called."""
        super().restore(observation)
        ends = np.cumsum([part.steps.flat.size for part in self._parts])
        for part, flat in zip(self._parts, np.split(observation, ends[:-1]), strict=True):
            part.steps.fill(flat)
        self._is_first = False

    def _of_robot(self, values: Floats) -> Floats:
        """Return values of the network's joints, shape (n,), in the order of the robot's."""
        found = np.empty_like(values)
        found[self._joints] = values
        return found


class _Values:
    """Makes arrays of what a page says of so many joints, or tells in a line why it cannot."""

    def __init__(self, path: Path, count: int) -> None:
        self.path, self.count = path, count

    def each(self, name: str, listed: list[float] | None, otherwise: float = 0.0, count: int = 0) -> Floats:
        """Return a number per joint, or ``count`` of them."""
        count = count or self.count
        values = np.full(count, otherwise) if listed is None else np.array(listed, dtype=np.float64)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise BadFile(f"{self.path}: {name}: expected {count} finite numbers, got {str(listed)[:80]}")
        return values

    def action(self, action: _Action) -> tuple[Floats, Floats, tuple[Floats, Floats]]:
        """Return scale, offset, and both ends of the clip."""
        every = [None, None, None], list(range(self.count))
        if action.joint_ids is not None and action.joint_ids not in every:
            raise BadFile(f"{self.path}: JointPositionAction: joint_ids {action.joint_ids}; expected all joints")
        clip = np.array(action.clip or [(-math.inf, math.inf)] * self.count)
        if len(clip) != self.count or np.isnan(clip).any():
            came = str(action.clip)[:80]
            raise BadFile(f"{self.path}: JointPositionAction: clip: expected {self.count} pairs of numbers, got {came}")
        scale, offset = self.each("scale", action.scale, 1.0), self.each("offset", action.offset)
        return scale, offset, (clip[:, 0], clip[:, 1])

    def part(self, name: str, term: _Term) -> _Part:
        """Return a term of an observation."""
        if name not in _TERMS:
            raise BadFile(f"{self.path}: observation {name!r} is not known here; known: {', '.join(_TERMS)}")
        size = self.count if name in _OF_JOINTS else 3
        scale = self.each(f"{name}: scale", term.scale, 1.0, size)
        steps = FrameHistory(term.history_length or 1, size)
        return _Part(_TERMS[name], term.clip or (-math.inf, math.inf), scale, steps)


def _motors(path: Path, listed: list[int], robot: str) -> dict[str, int]:
    """Return the joints of the robot with these motors, and the motor of each."""
    if robot and robot not in MOTORS:
        raise ConfigError(f"robot {robot!r} is not known{did_you_mean(robot, MOTORS)}; known: {', '.join(MOTORS)}")
    for name in [robot] if robot else MOTORS:
        if sorted(MOTORS[name].values()) == sorted(listed):
            return MOTORS[name]
    whose = f"robot {robot!r} has {sorted(MOTORS[robot].values())}" if robot else "no robot that is known has these"
    raise ConfigError(f"{path}: joint_ids_map: motors {listed}; {whose}; known: {', '.join(MOTORS)}")


def _read(path: Path) -> _Page:
    try:
        text = path.read_text(encoding="utf-8").replace(_ALL_JOINTS, "")
        return msgspec.convert(safe_yaml.load(text), _Page)
    except FileNotFoundError:
        raise BadFile(f"{path}: no such file; expected a deploy.yaml") from None
    except UnicodeDecodeError:
        raise BadFile(
            f"{path}: is no text; name the deploy.yaml that belongs to the network, as `checkpoint`"
        ) from None
    except (OSError, ValueError, msgspec.ValidationError) as error:
        raise BadFile(f"{path}: no deploy.yaml of a policy that follows velocities: {str(error)[:200]}") from None


def _network(path: Path) -> Path:
    names = [name.format(page=path.stem) for name in NETWORKS]
    found = next((path.parent / name for name in names if (path.parent / name).is_file()), None)
    if found is None:
        raise BadFile(f"{path}: its network is not there; expected {', '.join(names[:-1])} or {names[-1]} beside it")
    return found


def _sha256(page: Path, network: Path) -> str:
    """Return the hash of all files: page, network, and the weights of one whose file does not hold them."""
    files = [page, network, network.with_name(f"{network.name}.data")]
    return hashlib.sha256("".join(sha256(file) for file in files if file.is_file()).encode()).hexdigest()
