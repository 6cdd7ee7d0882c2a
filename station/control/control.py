"""One tick of a low-level loop: state, command, gate, policy, targets, robot. Protocols only: no bus, no clock.

The same step drives the station's servers and the offline rehearsal, so both give the same motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from station.clock import SYSTEM, Clock
from station.contract import names_of
from station.control.arming import Arming
from station.control.command_path import CommandPath, StepEvent
from station.control.command_validator import Samples
from station.control.envelope import Envelope, of_parts
from station.control.gate import Decision, Gate, GateConfig
from station.control.parted_path import PartedPath
from station.control.policy_switch import PolicySwitch, needs_root_velocity
from station.errors import ConfigError
from station.parts import PartedCommand, rests_on_joints
from station.protocols import (
    CommandFormat,
    Fall,
    Floats,
    Floats32,
    JointTargets,
    Policy,
    Robot,
    RobotState,
    SelfChecking,
)

_UPRIGHT_AGAIN_S = 1.0  # a fallen robot bounces; a fall is over when it has stood this long


@runtime_checkable
class Resettable(Protocol):
    """A robot that can be put back on its feet by software: a simulation."""

    def reset(self) -> None:
        """Return to the start pose, at rest."""
        ...


@dataclass(frozen=True, slots=True)
class StepRecord:
    """Everything that a step did.

    Attributes:
        tick: Number of the step, from 1.
        state: What the robot measured.
        decision: What the gate let through; `decision.vector` is the command that the policy got.
        observation, action: Input and raw output of the network, shapes (observation_size,), (action_size,).
        sent: Targets as really sent, after arming, stop and the robot's own limits; zero gains when disarmed.
        fall: Why the robot counts as fallen after this step, or None.
        command_seq: Sequence number of the command that was used; 0 when foreign or none.
        timing_ns: The six instants of `station.contract.TIMING_STAGES`; 0 where unknown.
        step_events: What happened, in order.
        policy, next_policy: Name of the policy whose observation and action they are, and of the one that listens to
            take over, or ""; both "" where a robot has but one.
    """

    tick: int
    state: RobotState
    decision: Decision
    observation: Floats32
    action: Floats32
    sent: JointTargets
    fall: Fall | None
    command_seq: int
    timing_ns: tuple[int, int, int, int, int, int]
    step_events: tuple[StepEvent, ...]
    policy: str = ""
    next_policy: str = ""


class ControlStep:
    """A robot, a policy and the gate between them and the command.

    Args:
        robot: With the joints of the policy.
        policy: Follows commands of the format.
        command_format: Format of the command.
        gate: Times of the gate.
        is_armed: Whether targets are sent from the start; False for real robots.
        reset_after_s: A simulated robot is put back on its feet this long after a fall [s]; None: never.
        envelopes: Commands that the policies survive; what is beyond is kept from them, and told.
        clock: Says how long a step takes, and decides nothing.

    Attributes:
        commanded: Validator, gate and arming; of each part, where parts are commanded apart.
        policies: The policies that hand over to each other; None where there is one alone.
        checks: The robot, where it checks itself; else None.

    Raises:
        ConfigError: the policy's joints are not the robot's, or it follows another format, or an envelope is of one.
    """

    def __init__(
        self,
        robot: Robot,
        policy: Policy,
        command_format: CommandFormat,
        *,
        gate: GateConfig | None = None,
        is_armed: bool = True,
        reset_after_s: float | None = None,
        envelopes: Sequence[Envelope] = (),
        clock: Clock = SYSTEM,
    ) -> None:
        _check_fit(robot, policy, command_format)
        self.robot, self.policy, self._clock = robot, policy, clock
        self.policies = policy if isinstance(policy, PolicySwitch) else None
        self.arming = Arming(is_armed=is_armed)
        config = gate or GateConfig()
        if isinstance(command_format, PartedCommand):
            self.commanded: CommandPath = PartedPath(command_format, config, self.arming, envelopes=envelopes)
        else:
            (own,) = of_parts(envelopes, [command_format])
            self.commanded = CommandPath(command_format, config, self.arming, envelopes=own)
        self._note = self.commanded.add_event
        self._reset_after_s, self._fell_at_s = reset_after_s, math.inf
        self._tick = self._falls = 0
        self._is_down = False
        self._stood_since_s = 0.0
        self._action_is_bad = False
        self._resting = tuple(_resting(robot, self.commanded.paths))
        self._asked: list[Floats] | None = None  # of those, positions of the last step; None: the joints are limp
        self._has_jumped = False  # whether the robot was put elsewhere after its state was read
        self._is_lost = False  # whether a joint that has to stay does not say where it is
        self.checks = robot if isinstance(robot, SelfChecking) else None
        self._unwell = ""

    def sense(self) -> RobotState:
        """Return the state that the next `step` acts on."""
        return self.robot.read()

    def step(self, state: RobotState, sample: Samples, now_s: float) -> StepRecord:
        """Act on a state and the newest command sample.

        Args:
            state: From `sense`.
            sample: The newest write of the command key, good or bad; the same object as long as nothing new came. Of a
                robot whose parts are commanded apart, that of each.
            now_s: The instant, on the clock of `CommandSample.arrived_s` [s].
        """
        self._tick += 1
        decision = self._decide(state, sample, now_s)
        observation = self.policy.observe(state, decision.vector)
        observed_ns = self._clock.monotonic_ns()
        action = self.policy.act(observation)
        inferred_ns = self._clock.monotonic_ns()
        targets = self._targets(action, state, decision)
        allowed = None if self._has_jumped else self._allowed(targets, now_s)
        sent_ns = self._clock.monotonic_ns()  # before `write`, which in a simulation also runs the physics
        if allowed is None:
            self.robot.damp()
            sent = _nothing(targets)
        else:
            sent = self.robot.write(allowed)
        is_limp = allowed is None or decision.state == "stopped" or self._action_is_bad or self._is_lost
        if not self._has_jumped:
            self._asked = None if is_limp else [decision.vector[resting.span] for resting in self._resting]
        self._has_jumped = False
        policy, listening = self._policies_of_step()
        good = self.commanded.paths[0].validator.good
        stages = (good.written_ns if good else 0, good.arrived_ns if good else 0)
        record = StepRecord(
            tick=self._tick,
            state=state,
            decision=decision,
            observation=observation,
            action=action,
            sent=sent,
            fall=self._detect_fall(now_s),
            command_seq=good.seq if good else 0,
            timing_ns=(*stages, state.mono_ns, observed_ns, inferred_ns, sent_ns),
            step_events=self.commanded.taken(),
            policy=policy,
            next_policy=listening,
        )
        if self._reset_after_s is not None and now_s - self._fell_at_s >= self._reset_after_s:
            self._fell_at_s = math.inf
            self.restart("fell")  # told with the next step, which sees the robot on its feet
        return record

    def stop(self, reason: str) -> None:
        """Latch the emergency stop: from the next step on the joints are only damped."""
        self.commanded.stop(reason)

    def reset(self, reason: str) -> None:
        """Leave the emergency stop; a simulated robot is put back on its feet, a real one needs arming again."""
        if self.commanded.state == "stopped":
            self.commanded.reset(reason)
            self._note("operator-reset", "warning", reason=reason)
            self._start_over()

    def restart(self, reason: str) -> None:
        """Put a simulated robot back on its feet and wait for commands anew."""
        if self.commanded.state != "stopped":
            self.commanded.reset(reason)
        self._note("robot-reset", "warning", reason=reason)
        self._start_over()

    def arm(self, now_s: float, who: str = "") -> str:
        """Begin to arm the robot; return why not, or ""."""
        return self.commanded.arm(now_s, who, self._why_not_arm(now_s))

    def disarm(self, who: str = "") -> None:
        """Send no targets to the robot from the next step on; its joints are damped."""
        self.commanded.disarm(who)

    def health(self) -> dict[str, Any]:
        """Return what a server's heartbeat tells of this robot."""
        own = self.checks.health() if self.checks is not None else {}
        return {"falls": self._falls} | own

    def _see_to_rest(self, state: RobotState) -> None:
        """Tell the gate where a robot, or a part, that holds its position rests.

        It rests where it was asked to be, not where it is: a joint that sags a little under its load, and were asked to
        be there, would sag on. Nor at its target: a policy that balances with the arms adds to what they are asked.
        While it is disarmed no command is followed, and the commander has to begin anew, but for a hand's: those of
        stock programs never pause.
        """
        self._is_lost = False
        for index, (gate, joints, _) in enumerate(self._resting):
            where = state.q[joints] if self._asked is None else self._asked[index]
            if np.isfinite(where).all():
                gate.rest(where)
            else:
                self._is_lost = True
                gate.insist_on_silence("the robot did not say where it is")
        if self.arming.state == "disarmed" and (self._resting or len(self.commanded.paths) > 1):
            for path in self.commanded.paths:
                if getattr(path.command_format, "awaits_pause", True):
                    path.gate.insist_on_silence("the robot was disarmed")

    def _decide(self, state: RobotState, sample: Samples, now_s: float) -> Decision:
        """Return what the gate lets through; nothing of a command while the robot has to stand."""
        self._see_to_rest(state)
        why_stand = self._check_robot(now_s)
        decision = self.commanded.decide(sample, now_s, why_blocked=why_stand)
        if why_stand and decision.state == "waiting":
            self._give_up(why_stand)
        return decision

    def _check_robot(self, now_s: float) -> str:
        """Ask a robot that checks itself; return why it has to stand, or "". Do what was asked for at the robot."""
        if self.checks is None:
            return ""
        for action in self.checks.pop_actions():
            if action == "arm":
                self.arm(now_s, "at the robot")
            elif action == "disarm":
                self.disarm("at the robot")
            elif action == "policy" and self.policies is not None:
                self.policies.switch_to_next("at the robot")
        if why_not := self.checks.why_not_drive():
            self._give_up(why_not)
            return ""
        why_stand = self.checks.why_stand() if self.arming.state != "disarmed" else ""
        if why_stand and not self._unwell:
            self._note("robot-has-to-stand", "warning", reason=why_stand)
        self._unwell = why_stand
        return why_stand

    def _give_up(self, reason: str) -> None:
        """Disarm a robot that must not be driven on, and tell why."""
        if self.arming.state != "disarmed":
            self._note("robot-fault", "error", reason=reason)
            self.disarm(reason)

    def _why_not_arm(self, now_s: float) -> str:
        if self.arming.state != "disarmed" and self.commanded.state != "stopped":
            return ""
        if refusal := self.commanded.why_not_arm(now_s):
            return refusal
        if self._action_is_bad:
            return "the policy's output is not finite"
        if self.checks is not None and (why_not := self.checks.why_not_arm()):
            return why_not
        return "the robot has fallen; put it on its feet" if self._is_down else ""

    def _start_over(self) -> None:
        self.policy.reset()
        self._asked = None
        self._is_down = False
        if isinstance(self.robot, Resettable):
            self.robot.reset()
            if self._resting:  # the state that the next step acts on was read before, so nothing may come of it
                q = self.robot.read().q
                self._asked, self._has_jumped = [q[resting.joints] for resting in self._resting], True
            self.arming.restart()
        else:
            self.arming.disarm()  # however it started: stiffness must not come back at once

    def _allowed(self, targets: JointTargets, now_s: float) -> JointTargets | None:
        was_arming = self.arming.state == "arming"
        allowed = self.arming.apply(targets, now_s)
        if was_arming and self.arming.state == "armed":
            self._note("armed", "warning")
        return allowed

    def _targets(self, action: Floats32, state: RobotState, decision: Decision) -> JointTargets:
        """Return the policy's targets, or damping alone when stopped or when the network gave no number."""
        targets = self.policy.targets(action, decision.vector)
        is_bad = not (np.isfinite(action).all() and np.isfinite(targets.q).all())
        if is_bad:
            self.policy.reset()  # what is not a number would stay in the history for ever
        if is_bad and not self._action_is_bad:
            self._note("bad-action", "error", reason="the policy's output is not finite; joints are damped")
        self._action_is_bad = is_bad
        if is_bad or self._is_lost or decision.state == "stopped":
            q = np.where(np.isfinite(state.q), state.q, self.policy.spec.default_q)
            return JointTargets(q, np.zeros_like(targets.kp), targets.kd)
        return targets

    def _policies_of_step(self) -> tuple[str, str]:
        """Return the names of the policy that drove and of the one that listened; tell what became of a switch."""
        if self.policies is None:
            return "", ""
        for event in self.policies.taken():
            self._note(event.name, event.severity, **event.detail)
        return self.policies.of_step

    def _detect_fall(self, now_s: float) -> Fall | None:
        fall = self.robot.fallen()
        if fall is not None:
            if not self._is_down:
                self._note("fall", "error", tilt_rad=fall.tilt_rad, contacts=list(fall.contacts))
                self._falls += 1
                self._fell_at_s = now_s
            self._is_down, self._stood_since_s = True, math.inf
        elif self._is_down:
            self._stood_since_s = min(self._stood_since_s, now_s)
            self._is_down = now_s - self._stood_since_s < _UPRIGHT_AGAIN_S
        return fall


def _nothing(targets: JointTargets) -> JointTargets:
    zeros: Floats = np.zeros_like(targets.kp)
    return JointTargets(targets.q, zeros, zeros)


def _check_fit(robot: Robot, policy: Policy, command_format: CommandFormat) -> None:
    spec = policy.spec
    if spec.command != command_format.name:
        raise ConfigError(f"policy {spec.name!r} follows {spec.command!r} commands, not {command_format.name!r}")
    if needs_root_velocity(policy) and robot.read().root_lin_vel is None:
        raise ConfigError(
            f"policy {spec.name!r}, or one that may take over from it, needs the velocity of the base, which this "
            "robot does not measure"
        )
    if spec.joint_names != robot.joint_names:
        odd = sorted(set(spec.joint_names) ^ set(robot.joint_names))
        raise ConfigError(
            f"policy {spec.name!r} drives {len(spec.joint_names)} joints, the robot has {len(robot.joint_names)}; "
            + (f"not in both: {', '.join(odd[:4])}" if odd else "their order differs")
        )


class _Resting(NamedTuple):
    """What stays without a command: its gate, the joints that its elements are, and where in the command those are."""

    gate: Gate
    joints: list[int]
    span: slice


def _resting(robot: Robot, paths: Sequence[CommandPath]) -> Iterator[_Resting]:
    """Yield what stays without a command.

    Velocities and a height are no joints: their gate keeps what was asked for last.
    """
    places = {f"{name}_pos": index for index, name in enumerate(robot.joint_names)}
    end = 0
    for path in paths:
        command = path.command_format
        names = names_of(command.elements)
        start, end = end, end + len(names)
        if rests_on_joints(command):
            odd = [name for name in names if name not in places]
            if odd:
                raise ConfigError(
                    f"what stays takes positions of joints; command {command.name!r} has {', '.join(odd[:4])}"
                )
            yield _Resting(path.gate, [places[name] for name in names], slice(start, end))
