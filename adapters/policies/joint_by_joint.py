"""A policy that moves one joint after the other a little, softly: whether each is the right one, before anything else.

For a robot that hangs. Every joint is held softly at the default pose of another policy, and one at a time is led a
little way to the positive side, back, to the negative side, and back. The others are held rather than damped alone:
limbs that are limp swing along with the one that moves, and which joint moved would not be seen. A soft joint moves
late, and one that carries a limb moves less than it is led.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState

_BEGINS_S = 1.5  # it listens before it drives, and is blended in: nothing is led before that is over
_REST = 0.25  # of the time of a joint: what swings comes to rest before the next one


class JointByJointPolicy:
    """Implements `station.protocols.Policy`; it has no network, its action is the targets [rad].

    It begins with the first joint when it takes over from another policy, and begins anew after the last.

    Args:
        checkpoint: File of the other policy.
        of: Registered name of the other policy, whose default pose and damping it has.
        kp: Stiffness of every joint [N m/rad].
        lead_rad: How far a joint is led to either side [rad].
        joint_s: How long a joint is led [s].
        joints: Which joints, by names in which ``*`` stands for anything: ``["*_wrist_*"]``.

    Raises:
        ConfigError: a number that no joint should be moved with, or no joint of such a name.
    """

    CHECKPOINT = "builtin:tracker.onnx"

    def __init__(
        self,
        checkpoint: Path,
        *,
        of: str = "tracker",
        kp: float = 10.0,
        lead_rad: float = 0.05,
        joint_s: float = 2.0,
        joints: Sequence[str] = ("*",),
    ) -> None:
        for name, value, most in (("kp", kp, 50.0), ("lead_rad", lead_rad, 0.2), ("joint_s", joint_s, 20.0)):
            if not (isinstance(value, int | float) and 0.0 < value <= most):
                raise ConfigError(f"joint-by-joint: {name} is {value!r}; expected more than 0, and {most:g} at most")
        other: Policy = registry.find("policy", of)(checkpoint)
        rate_hz, pose, names = other.spec.rate_hz, other.spec.default_q, other.spec.joint_names
        for pattern in joints:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise ConfigError(f"joint-by-joint: joints: {pattern!r} is none of {', '.join(names)}")
        self._led = [i for i, name in enumerate(names) if any(fnmatchcase(name, pattern) for pattern in joints)]
        self._pose, self._lead_rad = pose, lead_rad
        self._first_step = round(_BEGINS_S * rate_hz)
        self._led_steps, self._rest_steps = max(4, round(joint_s * rate_hz)), round(_REST * joint_s * rate_hz)
        self._count = 0
        self.spec: PolicySpec = replace(
            other.spec, name="joint-by-joint", kp=np.full(len(pose), kp), runtime="numpy",
            observation_size=1, action_size=len(pose),
        )  # fmt: skip

    @property
    def sweep_s(self) -> float:
        """Time from its beginning until the last joint is back [s]."""
        each = self._led_steps + self._rest_steps
        return (self._first_step + each * len(self._led)) / self.spec.rate_hz

    def reset(self) -> None:
        """Begin anew, before the first joint."""
        self._count = 0

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return how many steps it has gone, shape (1,): all that it remembers."""
        observation = np.array([self._count], dtype=np.float32)
        self._count += 1
        if self._count == self._first_step + (self._led_steps + self._rest_steps) * len(self._led):
            self._count = self._first_step
        return observation

    def act(self, observation: Floats32) -> Floats32:
        """Return where the joints are led, shape (n,) [rad]."""
        q = self._pose.astype(np.float32)
        since = round(float(observation[0])) - self._first_step
        if since >= 0:
            joint, step = divmod(since, self._led_steps + self._rest_steps)
            if step < self._led_steps:
                q[self._led[joint]] += np.float32(self._lead_rad * np.sin(2.0 * np.pi * step / self._led_steps))
        return q

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the action as targets."""
        return JointTargets(action.astype(np.float64), self.spec.kp, self.spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Go on behind the step that an observation shows."""
        self._count = round(float(observation[0])) + 1
