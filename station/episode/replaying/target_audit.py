"""Auditing what the joints were sent: the recorded action becomes targets again, by the policy that drove, bit for bit.

From an action to what a robot is sent lead the policy's own scale and gains, the blend of a hand-over, arming, and a
stop. Of these the blend and the ramp of the stiffness are not in the file: those are counted as not proven. So is what
differs on a robot that may limit what it is sent.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from station.bus import codec, keys
from station.control.gate import LATCHED
from station.episode.reading.steps import Step
from station.episode.replaying.comparison import Comparison
from station.episode.replaying.gate_audit import GateTold
from station.protocols import Floats, Floats32, Policy, RobotState

_BLENDED = "targets of two policies were blended"
_RAMPED = "stiffness was on its way up (the rest of the target was compared)"
_NO_TARGET = "it has no target that fits"
_NO_STATE = "it has no state or command that fits"
_LIMITED = "the target is not the policy's, and the robot may have limited it"


@dataclass
class TargetReplay:
    """Follows the steps of an episode with the policies that drove.

    Attributes:
        robot: Suffix of its keys.
        may_limit: Whether the robot may send other targets than it is given.
        blend_steps: For how many steps targets are blended after a hand-over.
        has_several: Whether the robot has several policies.
        targets: What was sent, derived and recorded: positions and gains.
        not_proven: How many steps were not compared, or not wholly, by why.
    """

    robot: str
    may_limit: bool
    blend_steps: int
    has_several: bool
    targets: Comparison = field(default_factory=Comparison)
    not_proven: Counter[str] = field(default_factory=Counter)
    _driving: str | None = None
    _blended: int = 0  # steps that are still blended

    def on_step(
        self, number: int, step: Step, told: GateTold, policy: Policy, given: tuple[RobotState, Floats] | None,
        action: Floats32,
    ) -> None:  # fmt: skip
        """Compare one step, of which the policy has just observed and acted.

        Args:
            number: Of the step, from 0 in the file.
            step: The step.
            told: What the gate told in it.
            policy: The one that drove.
            given: State and command that it was given; None where they are not in the file.
            action: As recorded.
        """
        driving = told.policy
        if self.has_several and driving != self._driving:
            self._blended = self.blend_steps
        self._driving, blended, self._blended = driving, self._blended, max(0, self._blended - 1)
        data, count = step.values.get(keys.target(self.robot)), len(policy.spec.joint_names)
        if data is None or len(data) != 24 * count:
            self.not_proven[_NO_TARGET] += 1
        elif given is None:
            self.not_proven[_NO_STATE] += 1
        elif blended:
            self.not_proven[_BLENDED] += 1
        else:
            self._compare(number, codec.parse_f64(data).reshape(3, count), told, policy, given, action)

    def _compare(
        self, number: int, sent: Floats, told: GateTold, policy: Policy, given: tuple[RobotState, Floats],
        action: Floats32,
    ) -> None:  # fmt: skip
        wanted = _wanted(told, policy, given, action)
        if told.arming == "arming":
            self.not_proven[_RAMPED] += 1
            sent, wanted = sent[[0, 2]], wanted[[0, 2]]
        if self.may_limit and sent.tobytes() != wanted.tobytes():
            self.not_proven[_LIMITED] += 1
            return
        self.targets.add(number, sent.ravel(), wanted.ravel())


def _wanted(told: GateTold, policy: Policy, given: tuple[RobotState, Floats], action: Floats32) -> Floats:
    """Return positions, stiffness and damping that a step sends, shape (3, joints)."""
    state, used = given
    targets = policy.targets(action, used)
    q, kp, kd = targets.q, targets.kp, targets.kd
    is_bad = not (np.isfinite(action).all() and np.isfinite(q).all())
    if is_bad or told.state in LATCHED:  # damped where it is
        q, kp = np.where(np.isfinite(state.q), state.q, policy.spec.default_q), np.zeros_like(kp)
    if told.arming == "disarmed":
        kp, kd = np.zeros_like(kp), np.zeros_like(kd)
    found: Floats = np.stack([q, kp, kd])
    return found
