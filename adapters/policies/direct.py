"""The policy `direct`: no network, joints go where the command says.

For a robot that takes positions of its joints, an arm above all. Its file, which stands where others have a checkpoint,
says for which robot it is:

```yaml
command: arm6-joints     # registered format, whose elements are the positions of the joints, in this order
rate_hz: 100
lead_rad: 0.3            # how far a target may be ahead of its joint
joints:
  - {name: base, kp: 300, kd: 30}                        # [N m/rad, N m s/rad]
  - {name: shoulder, kp: 300, kd: 30, default_rad: 0.5}
```
"""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np

from station import config, registry
from station.assets import sha256
from station.contract import names_of
from station.protocols import CommandFormat, Floats, Floats32, JointTargets, PolicySpec, RobotState


class JointGains(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One joint.

    Attributes:
        name: As the robot calls it.
        kp: Stiffness [N m/rad].
        kd: Damping [N m s/rad].
        default_rad: Stands for a joint that does not say where it is [rad].
    """

    name: str
    kp: float
    kd: float
    default_rad: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 < self.kp < math.inf and 0.0 <= self.kd < math.inf and math.isfinite(self.default_rad)):
            raise ValueError(f"{self.name}: kp {self.kp:g}, kd {self.kd:g}; expected a stiffness above 0 and a damping")


class DirectFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the file says.

    Attributes:
        command: Registered format of the commands.
        rate_hz: Their rate [Hz].
        joints: In the order of the command.
        lead_rad: How far a target may be ahead of its joint [rad]: an arm that is held up pushes with no more than its
            stiffness times that, and does not leap when it is let go. More than it lags at full speed and sags.
    """

    command: str
    rate_hz: float
    joints: tuple[JointGains, ...]
    lead_rad: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 < self.lead_rad < math.inf:
            raise ValueError(f"lead_rad is {self.lead_rad:g}; expected more than 0")
        registry.expect("command", self.command)
        command_format: CommandFormat = registry.find("command", self.command)
        wanted, named = names_of(command_format.elements), tuple(f"{joint.name}_pos" for joint in self.joints)
        if named != tuple(wanted):
            raise ValueError(f"joints: a command {self.command!r} has {', '.join(wanted)}; expected those, in order")


class DirectPolicy:
    """Implements `station.protocols.Policy`; the observation is the command, so is the action.

    Args:
        checkpoint: The file.

    Raises:
        BadFile: it cannot be read.
        ConfigError: it is no such file, or its joints are not those of the command.
    """

    def __init__(self, checkpoint: Path) -> None:
        path = Path(checkpoint)
        read = config.build(DirectFile, config.read_yaml(path), where=str(path))
        self._kp, self._kd = (np.array([getattr(joint, name) for joint in read.joints]) for name in ("kp", "kd"))
        self._kp.flags.writeable = self._kd.flags.writeable = False
        self._lead_rad = read.lead_rad
        self._q = np.array([joint.default_rad for joint in read.joints])
        size = len(read.joints)
        self._spec = PolicySpec(
            name="direct", checkpoint=path, sha256=sha256(path), runtime="none", rate_hz=read.rate_hz,
            command=read.command, joint_names=tuple(joint.name for joint in read.joints),
            default_q=np.array([joint.default_rad for joint in read.joints]), kp=self._kp, kd=self._kd,
            observation_size=size, action_size=size,
        )  # fmt: skip

    @property
    def spec(self) -> PolicySpec:
        """The constants of this policy."""
        return self._spec

    def reset(self) -> None:
        """There is no history."""

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the command, shape (n,) [rad]; where the joints are is remembered for the targets."""
        self._q = state.q
        return command.astype(np.float32)

    def act(self, observation: Floats32) -> Floats32:
        """Return the observation."""
        return observation

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the command itself, which has more digits than the action, no farther from a joint than its lead."""
        near = np.clip(command, self._q - self._lead_rad, self._q + self._lead_rad)
        return JointTargets(near, self._kp, self._kd)

    def restore(self, observation: Floats32) -> None:
        """There is no history."""
