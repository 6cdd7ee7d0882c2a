"""Several policies of one robot: one drives, and another takes over while the robot moves.

The one that is to take over first observes and acts beside the one that drives, so that its history is of this robot
and not of zeros. Then the targets of both are blended. Everything is counted in steps: a run in lock-step, its audit
and its replay switch at the same ones. Pure: no bus, no clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import msgspec
import numpy as np

from station.control.command_path import StepEvent
from station.errors import ConfigError, Refused, UnknownName
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState, TakesOver

LISTEN_S = 0.2
"""How long the next policy observes before its targets count [s]: as many frames as a history has, or nearly."""

BLEND_S = 0.5
"""How long the targets are blended [s]."""

BlendS = Annotated[float, msgspec.Meta(ge=0.0, le=5.0)]
"""A blend that a user may ask for [s]. It is bounded, because `station policy switch` waits until the blend is over."""

_NOT_FINITE = "its output is not finite"


class PolicySwitch:
    """Implements `station.protocols.Policy` by the policy that drives.

    Args:
        policies: By the name that they are asked for with; the first one drives.
        period_s: Control period [s].
        blend_s: How long the targets of the old and the new policy are blended [s].

    Attributes:
        driving: Name of the policy whose observation and action a step has.
        next: Name of the one that listens, to take over; "" for none.
        of_step: Both as they were when the newest step observed.
        refusal: Why the last switch came to nothing; "" where it did not fail.

    Raises:
        ConfigError: policies for other commands, joints or another rate than the first has.
    """

    def __init__(self, policies: Mapping[str, Policy], *, period_s: float, blend_s: float = BLEND_S) -> None:
        self._policies = dict(policies)
        self.driving, self.next, self.refusal = next(iter(self._policies)), "", ""
        self.of_step = (self.driving, "")
        self._listen_steps = max(1, round(LISTEN_S / period_s))
        self._blend_s, self._blend_steps = blend_s, max(1, round(blend_s / period_s))
        self._before = ""  # the one that drove, while targets are blended
        self._step = 0  # of listening, or of blending
        self._beside: Floats32 | None = None  # observation of the one that listens, or drove before
        self._beside_action: Floats32 = np.zeros(0, dtype=np.float32)
        self._is_bad = False  # whether what drives gave no number
        self._who = ""
        self._events: list[StepEvent] = []
        first = self._policies[self.driving].spec
        for name, policy in self._policies.items():
            _check_alike(self.driving, first, name, policy.spec)

    @property
    def names(self) -> tuple[str, ...]:
        """Of all policies; the one that drives at the start is the first."""
        return tuple(self._policies)

    @property
    def is_switching(self) -> bool:
        """Whether one hands over to another: it listens, or their targets are blended."""
        return bool(self.next or self._before)

    @property
    def policy(self) -> Policy:
        """The one that drives."""
        return self._policies[self.driving]

    @property
    def specs(self) -> dict[str, PolicySpec]:
        """The constants of each policy, by name."""
        return {name: policy.spec for name, policy in self._policies.items()}

    @property
    def spec(self) -> PolicySpec:
        """The constants of the one that drives."""
        return self.policy.spec

    def switch(self, name: str, who: str = "") -> None:
        """Begin to hand over to a policy.

        Raises:
            UnknownName: there is none of that name.
            Refused: it drives already, or another switch is under way.
        """
        if name not in self._policies:
            raise UnknownName("policy of this robot", name, self.names)
        if self.is_switching:
            old, new = self._before or self.driving, self.next or self.driving
            raise Refused(f"{old!r} hands over to {new!r} just now; ask again when that is done")
        if name == self.driving:
            raise Refused(f"policy {name!r} drives already")
        self.next, self._step, self._who, self.refusal = name, 0, who, ""
        self._policies[name].reset()

    def switch_to_next(self, who: str = "") -> None:
        """Begin to hand over to the policy that comes after the one that drives, unless a switch is under way."""
        if not self.is_switching and len(self._policies) > 1:
            names = self.names
            self.switch(names[(names.index(self.driving) + 1) % len(names)], who)

    def taken(self) -> list[StepEvent]:
        """Return what happened since the last call, in order."""
        taken, self._events = self._events, []
        return taken

    def reset(self) -> None:
        """Forget all history, as at start-up; a switch that is under way is over at once.

        This is called where a robot starts anew, or where what drives gave no number. The one that gave none does not
        go on: the one that drove before does, or the one that listens.
        """
        is_bad, self._is_bad = self._is_bad, False
        other = self._before if is_bad and self._before else self.next
        if other:
            self.refusal = _NOT_FINITE if other == self._before else ""
            self._drive(other, blend_s=0.0)
        if not (other and is_bad):
            self.policy.reset()
        self._before, self._beside = "", None

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Build the observation of this step, that of the policy that drives, shape (observation_size,)."""
        if self.next and self._step >= self._listen_steps:
            self._take_over(state, command)
        self.of_step = (self.driving, self.next)
        beside = self.next or self._before
        self._beside = self._policies[beside].observe(state, command) if beside else None
        return self.policy.observe(state, command)

    def act(self, observation: Floats32) -> Floats32:
        """Run the network of the policy that drives; return its raw output, shape (action_size,)."""
        action = self.policy.act(observation)
        self._is_bad = not np.isfinite(action).all()
        if self._beside is not None:
            self._step += 1
            self._beside_action = self._policies[self.next or self._before].act(self._beside)
            if self.next and not np.isfinite(self._beside_action).all():
                self._refuse(_NOT_FINITE)
        return action

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy that drives, for a while blended with those of the one before."""
        targets = self.policy.targets(action, command)
        if not self._before:
            return targets
        share = self._step / self._blend_steps
        before = self._policies[self._before].targets(self._beside_action, command)
        if share >= 1.0 or not np.isfinite(before.q).all():
            self._before = ""
            return targets
        return JointTargets(
            before.q + share * (targets.q - before.q),
            before.kp + share * (targets.kp - before.kp),
            before.kd + share * (targets.kd - before.kd),
        )

    def restore(self, observation: Floats32) -> None:
        """Restore the history of the policy that drives."""
        self.policy.restore(observation)

    def _take_over(self, state: RobotState, command: Floats) -> None:
        policy = self._policies[self.next]
        if isinstance(policy, TakesOver) and (why_not := policy.why_not_take_over(state, command)):
            self._refuse(why_not)
            return
        before = self.driving
        self._drive(self.next, blend_s=self._blend_s)
        self._before, self._step = before, 0

    def _drive(self, name: str, *, blend_s: float) -> None:
        detail = {"policy": name, "before": self.driving, "blend_s": blend_s, "who": self._who}
        self._events.append(StepEvent("policy-switched", "info" if blend_s else "warning", detail))
        self.driving, self.next = name, ""

    def _refuse(self, reason: str) -> None:
        detail = {"policy": self.next, "drives": self.driving, "reason": reason, "who": self._who}
        self._events.append(StepEvent("policy-switch-refused", "warning", detail))
        self.refusal, self.next = reason, ""


def needs_root_velocity(policy: Policy) -> bool:
    """Whether a policy, or one of those that hand over to each other, uses the velocity of the base."""
    specs = policy.specs.values() if isinstance(policy, PolicySwitch) else (policy.spec,)
    return any(spec.needs_root_velocity for spec in specs)


def _check_alike(first: str, expected: PolicySpec, name: str, came: PolicySpec) -> None:
    """Check that a policy can take over from the first: what moves the robot stays one command, at one rate."""
    if came.command != expected.command:
        raise ConfigError(
            f"policies: {name!r} follows {came.command!r} commands, {first!r} follows {expected.command!r}; only "
            "policies for the same commands hand over to each other"
        )
    if came.joint_names != expected.joint_names:
        raise ConfigError(f"policies: {name!r} drives other joints than {first!r}, or in another order")
    if came.rate_hz != expected.rate_hz:
        raise ConfigError(
            f"policies: {name!r} was trained at {came.rate_hz:g} Hz, {first!r} at {expected.rate_hz:g} Hz; only "
            "policies of one rate hand over to each other"
        )
