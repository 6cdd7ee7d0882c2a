"""Auditing an episode: the policy runs again on what was recorded, and every bit is compared.

Two questions. Does the checkpoint give the recorded actions for the recorded observations? And do the recorded state
and command give the recorded observations? With two times yes, the file holds everything that decided a motion.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from station import assets, registry
from station.bus import codec, keys
from station.contract import Contract
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step
from station.episode.replaying.recorded_policy import StatedPolicy, load_policy, recorded_policies
from station.errors import EpisodeError
from station.protocols import CommandFormat, Floats, Floats32, Policy, RobotState


class Comparison(msgspec.Struct, kw_only=True):
    """Recorded against computed vectors.

    Attributes:
        compared: Vectors that were compared.
        different: Those with any bit that differs.
        max_abs_difference: Greatest difference of an element; infinite where a length or a NaN differs.
        first_different: Number of the first step that differs, from 0 in the file; None when none does.
    """

    compared: int = 0
    different: int = 0
    max_abs_difference: float = 0.0
    first_different: int | None = None

    def add(self, step: int, recorded: Floats32 | Floats, computed: Floats32 | Floats) -> bool:
        """Add a pair; return whether it is equal bit for bit."""
        self.compared += 1
        if recorded.tobytes() == computed.tobytes():
            return True
        self.different += 1
        if self.first_different is None:
            self.first_different = step
        if recorded.shape != computed.shape:
            self.max_abs_difference = np.inf
        else:
            gap = np.abs(recorded.astype(np.float64) - computed.astype(np.float64))
            gap = np.where(np.isnan(recorded) & np.isnan(computed), 0.0, gap)
            self.max_abs_difference = max(self.max_abs_difference, float(np.nan_to_num(gap, nan=np.inf).max()))
        return False


class AuditedPolicy(msgspec.Struct, kw_only=True):
    """A policy that drove in an episode.

    Attributes:
        policy, checkpoint, sha256: What it was audited with.
        recorded_sha256: Hash of the checkpoint that ran, as its server stated it; "" when it did not.
        recorded_runtime, runtime: What ran the network then, and now. Other runtimes give other last bits.
    """

    policy: str
    checkpoint: str
    sha256: str
    recorded_sha256: str
    recorded_runtime: str
    runtime: str


class Audit(AuditedPolicy, kw_only=True):
    """What an audit found; the policy is the one that drove first.

    Attributes:
        episode_id, robot: What was audited.
        took_over: The other policies that drove.
        steps: Policy steps whose observation and action are in the file.
        different: Those whose action differs in any bit.
        max_abs_difference: Greatest difference of an element of an action.
        first_different: Number of the first step that differs, or None.
        observations: The same for observations derived again from recorded state and command.
        not_derived: Why an observation could not be derived, of the first such step; "" where there is none.
        segments: Runs of steps without a missing one; derivation starts anew at each.
        incomplete: Steps that lack an observation or an action of a size that the policy has.
        seconds: Time that the audit took [s].
        recorded_s: Time from the first step to the last [s].
        speed_x_realtime: One by the other.
    """

    episode_id: str
    robot: str
    took_over: list[AuditedPolicy] = []
    steps: int
    different: int
    max_abs_difference: float
    first_different: int | None
    observations: Comparison
    not_derived: str
    segments: int
    incomplete: int
    seconds: float
    recorded_s: float
    speed_x_realtime: float

    @property
    def is_equal(self) -> bool:
        """Whether actions and observations were compared, and every bit of them is the same."""
        is_audited = self.steps > 0 and self.observations.compared > 0
        return is_audited and not self.different and not self.observations.different


def audit(
    reader: EpisodeReader,
    *,
    checkpoint: str | Path | None = None,
    policy: Policy | None = None,
    robot: str | None = None,
) -> Audit:
    """Run the policy of an episode again on everything it was given, and compare.

    Args:
        reader: The episode.
        checkpoint: Another place of the checkpoint, path or ``collection:path``; its hash must be the recorded one.
        policy: A policy that is loaded already, in place of the recorded one.
        robot: Suffix of the robot; needed only when the episode has several.

    Raises:
        EpisodeError: no policy steps, the episode does not name its policy, or another checkpoint than that.
        AssetMissing, BadFile: the checkpoint is not on this machine.
    """
    suspects = recorded_policies(reader, robot)
    (suspect, *_) = suspects.values()
    if policy is not None:
        suspects = {"": suspect}
    places = _places(reader, suspects, checkpoint)

    @cache
    def load(name: str) -> Policy:
        return policy or load_policy(reader, suspects[name], places[name])

    began = time.perf_counter()
    run = _Run(load, tuple(suspects), suspect.robot, reader.contract(keys.robot_state(suspect.robot)))
    gate = (keys.command_gate,) if len(suspects) > 1 else ()  # says which of them drove
    families = (keys.policy_obs, keys.policy_action, keys.command_used, *gate)
    for step in steps.iterate(reader, suspect.robot, results=families):
        run.on_step(step)
    seconds = time.perf_counter() - began
    actions = run.actions
    first, *others = [_audited(suspects[name], load(name)) for name in run.drove or list(suspects)[:1]]
    recorded_s = (run.last_ns - run.first_ns) * 1e-9
    return Audit(
        episode_id=reader.episode_id,
        robot=suspect.robot,
        **msgspec.structs.asdict(first),
        took_over=others,
        steps=actions.compared,
        different=actions.different,
        max_abs_difference=actions.max_abs_difference,
        first_different=actions.first_different,
        observations=run.observations,
        not_derived=run.not_derived,
        segments=run.segments,
        incomplete=run.incomplete,
        seconds=seconds,
        recorded_s=recorded_s,
        speed_x_realtime=recorded_s / seconds if seconds > 0 else 0.0,
    )


def _places(
    reader: EpisodeReader, suspects: Mapping[str, StatedPolicy], checkpoint: str | Path | None
) -> dict[str, str | Path | None]:
    """Return by name where a policy's checkpoint is, if that is given; of several policies it is that of one."""
    if checkpoint is None or len(suspects) == 1:
        return dict.fromkeys(suspects, checkpoint)
    came = assets.sha256(assets.resolve(str(checkpoint)))
    found = {name: checkpoint if each.sha256 == came else None for name, each in suspects.items()}
    if not any(found.values()):
        ran = ", ".join(f"{name} {each.sha256[:12]}…" for name, each in suspects.items())
        raise EpisodeError(
            f"episode {reader.episode_id}: ran checkpoints of sha256 {ran}; {checkpoint} is {came[:12]}…, none of them"
        )
    return found


def _audited(suspect: StatedPolicy, policy: Policy) -> AuditedPolicy:
    spec = policy.spec
    return AuditedPolicy(
        policy=spec.name, checkpoint=str(spec.checkpoint), sha256=spec.sha256, recorded_sha256=suspect.sha256,
        recorded_runtime=suspect.runtime, runtime=spec.runtime,
    )  # fmt: skip


@dataclass
class _Run:
    """Follows the steps of an episode with policies of our own; `state` says what `keys.robot_state` holds.

    `load` returns one of `names` when it is needed: what never drove need not be on this machine. `drove` has the names
    of those that drove, in order.
    """

    load: Callable[[str], Policy]
    names: tuple[str, ...]
    robot: str
    state: Contract | None
    actions: Comparison = field(default_factory=Comparison)
    observations: Comparison = field(default_factory=Comparison)
    drove: list[str] = field(default_factory=list)
    not_derived: str = ""
    segments: int = 0
    incomplete: int = 0
    first_ns: int = 0
    last_ns: int = 0
    _count: int = 0
    _before: Step | None = None
    _driving: str = ""
    _next: str | None = None  # who listened in the step before; None where that is not in the file
    _heard: str = ""  # the same, where every step since it began to listen is in the file

    def on_step(self, step: Step) -> None:
        """Compare one step."""
        number, self._count = self._count, self._count + 1
        self.first_ns = self.first_ns or step.at_ns
        self.last_ns = step.at_ns
        if self._before is None or not _follows(self._before, step):
            self._before, self._next, self._heard = None, None, ""
        listening = self._choose(step)
        seen, done = step.values.get(keys.policy_obs(self.robot)), step.values.get(keys.policy_action(self.robot))
        spec = self.policy.spec
        if seen is None or done is None or len(seen) != 4 * spec.observation_size or len(done) % 4:
            self.incomplete += 1
            self._before = None
            return
        observation = codec.parse_f32(seen)
        self._derive(number, step, observation)
        self.actions.add(number, codec.parse_f32(done), self.policy.act(observation))
        self._before = step
        self._listen(listening, step)

    def _choose(self, step: Step) -> str:
        """Take the policy that drove in a step; return the name of the one that listened, or ""."""
        driving, listening = self.names[0], ""
        if len(self.names) > 1:
            gate = codec.parse_facts(step.values.get(keys.command_gate(self.robot)))
            driving, listening = (
                name if (name := gate.get(which)) in self.names else other
                for which, other in (("policy", self._driving or driving), ("next_policy", ""))
            )
        if driving not in (self._driving, self._heard):
            self._before = None  # what it had seen before it drove is not known
        if driving not in self.drove:
            self.drove.append(driving)
            command_format: CommandFormat = registry.find("command", self.load(driving).spec.command)
            self._command_size = len(command_format.default)
        self._driving, self.policy = driving, self.load(driving)
        return listening

    def _listen(self, name: str, step: Step) -> None:
        """Have the policy that is to take over observe and act too, as it did beside the one that drove."""
        begins = name != self._next
        is_heard = bool(name) and (self._next == "" if begins else self._heard == name)
        given = self._given(step) if is_heard else None
        self._next, self._heard = name, name if given is not None else ""
        if given is not None:
            policy = self.load(name)
            if begins:
                policy.reset()
            policy.act(policy.observe(*given))

    def _given(self, step: Step) -> tuple[RobotState, Floats] | None:
        """Return what a policy was given in a step, state and command; None where either is not in the file."""
        state = steps.robot_state(self.state, step.values.get(keys.robot_state(self.robot), b""))
        used = step.values.get(keys.command_used(self.robot))
        if state is None or used is None or len(used) != 8 * self._command_size:
            return None
        return state, codec.parse_f64(used)

    def _derive(self, number: int, step: Step, observation: Floats32) -> None:
        """Compare the observation with one made from state and command; the recorded one is the history in any case."""
        is_next = self._before is not None
        self.segments += not is_next
        if (given := self._given(step)) is None:
            has_state = steps.robot_state(self.state, step.values.get(keys.robot_state(self.robot), b"")) is not None
            lacking = keys.command_used(self.robot) if has_state else keys.robot_state(self.robot)
            self.not_derived = self.not_derived or f"step {number} has no {lacking} that fits what the key holds"
            self.policy.restore(observation)
            return
        derived = self.policy.observe(*given) if is_next else None
        if derived is None or derived.tobytes() != observation.tobytes():
            # At the start of an episode, and after an operator's reset, a policy knows no past.
            self.policy.reset()
            fresh = self.policy.observe(*given)
            if fresh.tobytes() == observation.tobytes():
                derived = fresh
            else:
                self.policy.restore(observation)
        if derived is not None:
            self.observations.add(number, observation, derived)


def _follows(before: Step, after: Step) -> bool:
    return (
        before.source == after.source
        and after.number == before.number + 1
        and after.state_number == before.state_number + 1
    )
