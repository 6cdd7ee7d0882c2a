"""What a robot, a policy and a motion are to the rest of the station.

SI units. Quaternions are ``w x y z``. "Root" is the base, a humanoid's pelvis: X forward, Y left, Z up. Arrays are
float64 unless a line says otherwise; none of them may be changed by the code that receives it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from station.contract import Element

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class RobotState:
    """What the robot measured at one instant.

    Attributes:
        mono_ns: When it was read, on this machine's monotonic clock [ns].
        q: Joint positions, shape (n,) [rad].
        dq: Joint velocities, shape (n,) [rad/s].
        quat_wxyz: Orientation of the root in the world, shape (4,).
        gyro: Angular velocity in the root frame, shape (3,) [rad/s].
        root_pos: Position of the root in the world, shape (3,) [m]; None where nothing measures it.
        root_lin_vel: Velocity of the root, in the root frame, shape (3,) [m/s]; None where nothing measures it.
    """

    mono_ns: int
    q: Floats
    dq: Floats
    quat_wxyz: Floats
    gyro: Floats
    root_pos: Floats | None = None
    root_lin_vel: Floats | None = None


@dataclass(frozen=True, slots=True)
class JointTargets:
    """What the joints are asked to do: torque = kp (q - q_measured) - kd dq_measured.

    Attributes:
        q: Position targets, shape (n,) [rad].
        kp: Stiffness, shape (n,) [N m/rad].
        kd: Damping, shape (n,) [N m s/rad].
    """

    q: Floats
    kp: Floats
    kd: Floats


LARGEST_JOINT_ERROR_RAD = 1e6
"""An error of a joint beyond it was not measured [rad]."""

FALL_TILT_RAD = math.radians(60.0)
"""A root that leans more than this has fallen. The root, not the link above the waist: people bow, and a motion that
bows by 60° is no fall; and the root is where a robot's IMU is, so the same rule holds for real ones."""


@dataclass(frozen=True, slots=True)
class Fall:
    """Why the robot counts as fallen.

    Attributes:
        tilt_rad: Angle between the root's up and the world's up [rad].
        contacts: Bodies other than the feet that touch the ground.
    """

    tilt_rad: float
    contacts: tuple[str, ...]


@runtime_checkable
class Robot(Protocol):
    """A robot with position-controlled joints, simulated or real.

    One `read` and one `write` per control period; in simulation `write` also advances the physics by that period,
    so the same loop serves both.
    """

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints, in the order of every vector."""
        ...

    def read(self) -> RobotState:
        """Return the newest measurement."""
        ...

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets and return what was really sent, after the robot's own limits."""
        ...

    def damp(self) -> None:
        """Have the joints damped and nothing else, until the next `write`: what disarmed means, said in every period.

        A robot that sends by itself, from a thread of its own, sends damping from now on, whatever it was sent before.
        A simulation stands still.
        """
        ...

    def fallen(self) -> Fall | None:
        """Return why the robot counts as fallen, or None when it stands (or cannot know)."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this robot: model file and hash, backend, time steps."""
        ...

    def close(self) -> None:
        """Leave the robot in its safe state and release it."""
        ...


@runtime_checkable
class SelfChecking(Protocol):
    """A robot that knows when it must not be driven: a real one. Asked in every control period."""

    def why_not_arm(self) -> str:
        """Return why it must not be armed now, or ""."""
        ...

    def why_not_drive(self) -> str:
        """Return why its joints have to be damped now, or ""; it is disarmed then, and armed again by a person."""
        ...

    def why_stand(self) -> str:
        """Return why it has to leave its command and stand, to be disarmed once it does, or ""."""
        ...

    def pop_actions(self) -> list[str]:
        """Return what a person asked for at the robot itself since the last call: arm, policy (the next), disarm."""
        ...

    def release(self) -> None:
        """Have a controller of the robot's own let go of its motors; returns at once. The robot goes limp."""
        ...

    def releasing(self) -> tuple[bool, str]:
        """Return whether a release is under way, and why the last one came to nothing, or ""."""
        ...

    def values(self) -> Mapping[str, bytes]:
        """Return what it measured since the last call beside its state, by the name of its stream."""
        ...

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        ...


@runtime_checkable
class SimulatedRobot(Robot, Protocol):
    """What a simulated robot may offer beside: enough to be tried out. Not every robot has it."""

    @property
    def joint_speeds(self) -> Floats:
        """Greatest speed of each joint, shape (n,) [rad/s]."""
        ...

    def reset(self) -> None:
        """Return to the start pose, at rest."""
        ...

    def push(self, velocity_step: Floats) -> None:
        """Add to the velocity of the root in the world, shape (3,) [m/s]: what a short, hard push does."""
        ...


@runtime_checkable
class HasGroundTruth(Protocol):
    """A simulated robot, which knows where it is."""

    @property
    def qpos(self) -> Floats:
        """Root position [m], root quaternion wxyz, n joints [rad]; shape (7 + n,)."""
        ...


@dataclass(frozen=True, slots=True)
class PolicySpec:
    """The constants of a policy.

    Attributes:
        name: Registered name of its family, for example ``twist2``.
        checkpoint: The file it was loaded from.
        sha256: Hash of that file.
        runtime: What runs it, with version, for example ``onnxruntime 1.31.1 CPU``.
        rate_hz: Rate it was trained at [Hz].
        command: Registered name of the command format that it follows.
        joint_names: The n joints that its targets are for.
        default_q: Joint positions at action zero, shape (n,) [rad].
        kp, kd: Gains, shape (n,).
        observation_size, action_size: Lengths of its input and output.
        command_lower, command_upper: Range of each element of the command that it was trained on, shape (m,); what is
            beyond is clamped and told. Only of a format for any robot (`ForAnyRobot`); None for the format's own.
        needs_root_velocity: Whether it uses `RobotState.root_lin_vel`, which not every robot measures.
        part: Name of the part of its command that it listens to, where parts are commanded apart; "" for all of it.
    """

    name: str
    checkpoint: Path
    sha256: str
    runtime: str
    rate_hz: float
    command: str
    joint_names: tuple[str, ...]
    default_q: Floats
    kp: Floats
    kd: Floats
    observation_size: int
    action_size: int
    command_lower: Floats | None = None
    command_upper: Floats | None = None
    needs_root_velocity: bool = False
    part: str = ""


class Policy(Protocol):
    """A whole-body policy: observation in, joint targets out. Keeps its own history between steps."""

    @property
    def spec(self) -> PolicySpec:
        """The constants of this policy."""
        ...

    def reset(self) -> None:
        """Forget all history, as at start-up."""
        ...

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Build the observation of this step, shape (observation_size,); call once per step, before `act`."""
        ...

    def act(self, observation: Floats32) -> Floats32:
        """Run the network; return its raw output, shape (action_size,), and remember it for the next observation."""
        ...

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Turn a raw output (and what of the command bypasses the network) into joint targets."""
        ...

    def restore(self, observation: Floats32) -> None:
        """Restore the history that a recorded observation shows, as if that step had just been observed."""
        ...


@runtime_checkable
class TakesOver(Protocol):
    """A policy that cannot take over from every state."""

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        """Return why it cannot drive from here on, in words, or ""; asked once, just before it would."""
        ...


@dataclass(frozen=True, slots=True)
class Reference:
    """What a motion asks of the robot at one instant.

    Attributes:
        root_pos: Position of the root in the motion's world, shape (3,) [m]; z is the height above ground.
        root_quat_wxyz: Orientation of the root in that world, shape (4,).
        root_lin_vel: Velocity of the root, in the root frame, shape (3,) [m/s].
        root_ang_vel: Angular velocity of the root, in the root frame, shape (3,) [rad/s].
        q: Joint positions, shape (n,) [rad], in the order of `Motion.joint_names`.
    """

    root_pos: Floats
    root_quat_wxyz: Floats
    root_lin_vel: Floats
    root_ang_vel: Floats
    q: Floats


class Motion(Protocol):
    """A recorded motion of the whole body that can be sampled at any time."""

    @property
    def name(self) -> str:
        """Short name, usually that of the file."""
        ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of `Reference.q`."""
        ...

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last [s]."""
        ...

    @property
    def fps(self) -> float:
        """Rate of the recorded frames [Hz]; need not be whole."""
        ...

    def at(self, time_s: float) -> Reference:
        """Return the reference at a time, clamped to 0..duration_s; positions interpolated, rotations by slerp."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this motion: file, sha256, frames, fps, what was trimmed or bridged."""
        ...


@dataclass(frozen=True, slots=True)
class StockKeys:
    """What foreign programs expect of a commander, beside the values of `CommandFormat.auxiliary`.

    Attributes:
        returning: Those of the auxiliary keys that go back to their default when driving ends; others keep their
            value, as a hand that holds something does.
        clocks: Keys that hold the wall clock of the command [ms since the epoch].
        signals: Keys with which a remote starts a motion or has it leave: ``1`` while its button is down.
    """

    returning: frozenset[str] = frozenset()
    clocks: tuple[str, ...] = ()
    signals: Mapping[str, Literal["start", "leave"]] = field(default_factory=dict)


class CommandFormat(Protocol):
    """A whole-body command vector as it stands on the bus; m is its length."""

    @property
    def name(self) -> str:
        """Registered name, for example ``twist2``."""
        ...

    @property
    def robot(self) -> str:
        """Robot suffix of its keys."""
        ...

    @property
    def key(self) -> str:
        """Bus key that carries the vector."""
        ...

    @property
    def elements(self) -> tuple[Element, ...]:
        """Name and unit of each of the m numbers; a joint's position is ``<joint>_pos`` [rad]."""
        ...

    @property
    def note(self) -> str:
        """What the names do not say, frames above all, in a sentence; "" for nothing."""
        ...

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Keys that stock readers expect beside it (hands, neck), with the value that asks for nothing."""
        ...

    @property
    def stock(self) -> StockKeys:
        """What else stock programs expect; ``StockKeys()`` for nothing."""
        ...

    @property
    def default(self) -> Floats:
        """The vector that asks the robot to stand, shape (m,)."""
        ...

    @property
    def lower(self) -> Floats:
        """Least value of each element, shape (m,); a value below it is clamped."""
        ...

    @property
    def upper(self) -> Floats:
        """Greatest value of each element, shape (m,)."""
        ...

    @property
    def margin(self) -> Floats:
        """How far outside its range an element is still clamped rather than refused, shape (m,)."""
        ...

    @property
    def rate(self) -> Floats:
        """Greatest change of each element per second, shape (m,); infinite where it has none."""
        ...

    @property
    def holds_position(self) -> bool:
        """Whether a robot without a command stays where it is (an arm) instead of going back to `default`."""
        ...

    @property
    def velocities(self) -> tuple[int, ...]:
        """Indices of the elements that are velocities of the robot, 0 in `default`; they fade where commands are lost.

        A position that is held keeps the robot in place; a velocity that is held moves it on.
        """
        ...

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return the vector that asks for a reference whose joints are named, shape (m,)."""
        ...


@runtime_checkable
class ForAnyRobot(Protocol):
    """A command format that any robot may take (velocities): registered without a robot, so with no key of its own."""

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return it as one robot takes it, by the suffix of its keys, within a range, shape (m,); None for its own."""
        ...
