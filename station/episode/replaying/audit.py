"""Auditing an episode: policy and gate run again on what was recorded, and every bit is compared.

Four questions, in the order of a step. Do the recorded commands give what the gate let through
(`station.episode.replaying.gate_audit`)? Do state and that command give the recorded observations? Does the checkpoint
give the recorded actions for them? And do those give the targets that were sent
(`station.episode.replaying.target_audit`)? With four times yes, the file holds everything that decided a motion. What
cannot be proven is counted, and never called equal.

A recording may do without observations (`station.episode.storage.left_out`). They are derived then, from the first
step that a policy made without a past, and are right as far as the actions that come of them are. Of steps before that
nothing is proven.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from station import assets
from station.bus import codec, keys
from station.command_formats import command_format
from station.contract import Contract
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step
from station.episode.replaying.comparison import Comparison
from station.episode.replaying.gate_audit import GatesReplay, GateTold, gate_told, replay
from station.episode.replaying.recorded_policy import (
    StatedPolicy,
    is_simulated,
    load_policy,
    recorded_policies,
    stated_facts,
)
from station.episode.replaying.target_audit import TargetReplay
from station.errors import EpisodeError, StationError
from station.protocols import Floats, Floats32, Policy, RobotState

_COMPARED = (
    keys.policy_obs, keys.policy_action, keys.command_used, keys.command_gate, keys.policy_timing, keys.target,
)  # fmt: skip


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
        first_different, first_different_s: Number of the first step that differs, and when that was, from the start of
            the episode [s]; None where none does.
        observations: The same for observations derived again from recorded state and command.
        not_derived: Why an observation could not be derived, of the first such step; "" where there is none.
        has_observations: Whether observations were recorded; else they are derived for the actions.
        past_unknown: Steps without a recorded observation before which something is not in the file that the policy had
            seen, so that its action could not be derived.
        commands: The same for what the gate let through, derived from the recorded commands.
        gates_different, first_gate_different_s: Steps in which the gate was in another state than derived, and when the
            first was [s].
        parts: Of a robot whose parts are commanded apart the same for each, by its name; else empty.
        command_key: Key of the commands that went through the gate again, of parts all of them; "" where none did.
        commands_not_proven: How many steps the gate could not be followed through, by why.
        targets: The same for what was sent to the joints, positions and gains, derived from the recorded actions.
        targets_not_proven: How many steps their targets could not be derived in, wholly or in part, by why.
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
    first_different_s: float | None
    observations: Comparison
    not_derived: str
    has_observations: bool = True
    past_unknown: int = 0
    commands: Comparison
    parts: dict[str, Comparison] = {}
    gates_different: int
    first_gate_different_s: float | None
    command_key: str
    commands_not_proven: dict[str, int]
    targets: Comparison
    targets_not_proven: dict[str, int]
    segments: int
    incomplete: int
    seconds: float
    recorded_s: float
    speed_x_realtime: float

    @property
    def is_equal(self) -> bool:
        """Whether actions and, if recorded, observations were compared, and no bit of what was compared differs."""
        is_audited = self.steps > 0 and (self.observations.compared > 0 or not self.has_observations)
        return is_audited and not self.differences

    @property
    def differences(self) -> int:
        """How many vectors and states of the gate are not what was computed."""
        compared = (self.observations, self.commands, self.targets)
        return self.different + self.gates_different + sum(one.different for one in compared)


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
    facts = stated_facts(reader, suspect.robot)
    followed = suspect.command or (load(next(iter(suspects))).spec.command if policy is not None else "")
    state = reader.contract(keys.robot_state(suspect.robot))
    gate = replay(suspect.robot, facts, followed, reader.anchor, state)
    targets = TargetReplay(
        suspect.robot, may_limit=not is_simulated(facts), blend_steps=_blend_steps(facts), has_several=len(suspects) > 1
    )
    run = _Run(
        load, tuple(suspects), suspect.robot, state, targets, None if isinstance(gate, str) else gate,
        has_observations=keys.policy_obs(suspect.robot) in reader.topics(),
    )  # fmt: skip
    run.on_file(reader)
    run.place(reader.start_ns)
    audited = [_audited(suspects[name], load(name)) for name in run.drove or list(suspects)[:1]]
    return _result(reader.episode_id, run, gate, audited, time.perf_counter() - began)


def _result(
    episode_id: str, run: _Run, gate: GatesReplay | str, audited: Sequence[AuditedPolicy], seconds: float
) -> Audit:
    """Return what was found; `gate` says in words why it was not followed."""
    actions, targets, recorded_s = run.actions, run.targets, (run.last_ns - run.first_ns) * 1e-9
    first, *others = audited
    states = Comparison() if isinstance(gate, str) else Comparison.of_all([g.states for g in gate.gates.values()])
    return Audit(
        episode_id=episode_id,
        robot=run.robot,
        **msgspec.structs.asdict(first),
        took_over=others,
        steps=actions.compared,
        different=actions.different,
        max_abs_difference=actions.max_abs_difference,
        first_different=actions.first_different,
        first_different_s=actions.first_different_s,
        observations=run.observations,
        not_derived=run.not_derived,
        has_observations=run.has_observations,
        past_unknown=run.past_unknown,
        commands=Comparison() if isinstance(gate, str) else Comparison.of_all(gate.commands),
        parts={} if isinstance(gate, str) else {name: one.commands for name, one in gate.gates.items() if name},
        gates_different=states.different,
        first_gate_different_s=states.first_different_s,
        command_key="" if isinstance(gate, str) else ", ".join(gate.command_keys),
        commands_not_proven={gate: run.count} if isinstance(gate, str) else gate.not_proven,
        targets=targets.targets,
        targets_not_proven=dict(targets.not_proven),
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
    found = {name: checkpoint if _is_of(reader, each, checkpoint) else None for name, each in suspects.items()}
    if not any(found.values()):
        ran = ", ".join(f"{name} {each.sha256[:12]}…" for name, each in suspects.items())
        came = assets.sha256(assets.resolve(str(checkpoint)))
        raise EpisodeError(
            f"episode {reader.episode_id}: ran checkpoints of sha256 {ran}; {checkpoint} is {came[:12]}…, none of them"
        )
    return found


def _is_of(reader: EpisodeReader, suspect: StatedPolicy, checkpoint: str | Path) -> bool:
    try:
        load_policy(reader, suspect, checkpoint)
    except StationError:
        return False
    return True


def _blend_steps(facts: Mapping[str, Any]) -> int:
    """Return for how many steps the targets of two policies were blended; many where nothing says."""
    try:
        return max(1, round(float(facts["config"]["blend_s"]) * float(facts["rates"]["control_hz"])))
    except (KeyError, TypeError, ValueError, OverflowError):
        return _LONGEST_BLEND


def _audited(suspect: StatedPolicy, policy: Policy) -> AuditedPolicy:
    spec = policy.spec
    return AuditedPolicy(
        policy=spec.name, checkpoint=str(spec.checkpoint), sha256=spec.sha256, recorded_sha256=suspect.sha256,
        recorded_runtime=suspect.runtime, runtime=spec.runtime,
    )  # fmt: skip


_LONGEST_BLEND = 1000  # steps, where an episode does not say


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
    targets: TargetReplay
    gate: GatesReplay | None
    has_observations: bool
    past_unknown: int = 0
    actions: Comparison = field(default_factory=Comparison)
    observations: Comparison = field(default_factory=Comparison)
    drove: list[str] = field(default_factory=list)
    not_derived: str = ""
    segments: int = 0
    incomplete: int = 0
    first_ns: int = 0
    last_ns: int = 0
    count: int = 0
    _times: array[int] = field(default_factory=lambda: array("q"))  # of every step [ns]
    _before: Step | None = None
    _driving: str = ""
    _next: str | None = None  # who listened in the step before; None where that is not in the file
    _heard: str = ""  # the same, where every step since it began to listen is in the file
    _knows_past: bool = False  # whether the policy holds what it held then; asked where observations are not recorded

    def on_file(self, reader: EpisodeReader) -> None:
        """Compare all steps of a file."""
        joiner = steps.StepJoiner(self.robot, _COMPARED, parts=self.gate.parts if self.gate else ())
        heard = {*self.gate.command_keys, keys.EVENT} if self.gate is not None else set[str]()
        for message in reader.messages(joiner.topics | heard):
            if self.gate is not None and message.topic in heard:
                self.gate.on_message(message)
            elif (step := joiner.feed(message)) is not None:
                self.on_step(step)
        for step in joiner.finish():
            self.on_step(step)

    def place(self, start_ns: int) -> None:
        """Say when the first difference of each kind was, by the start of the episode [ns since the epoch]."""
        followed = self.gate.followed if self.gate is not None else ()
        for found in (self.actions, self.observations, self.targets.targets, *followed):
            found.place(self._times, start_ns)

    def on_step(self, step: Step) -> None:
        """Compare one step."""
        number, self.count = self.count, self.count + 1
        self._times.append(step.at_ns)
        told = gate_told(step, self.robot)
        if self.gate is not None:
            self.gate.on_step(number, step)
        self.first_ns = self.first_ns or step.at_ns
        self.last_ns = step.at_ns
        if self._before is None or not _follows(self._before, step):
            self._before, self._next, self._heard = None, None, ""
        listening = self._choose(step, told)
        seen, done = step.values.get(keys.policy_obs(self.robot)), step.values.get(keys.policy_action(self.robot))
        size, given = 4 * self.policy.spec.observation_size, self._given(step)
        has_seen = len(seen or b"") == size if self.has_observations else given is not None
        if not has_seen or done is None or len(done) % 4:
            self.incomplete += 1
            self._before = None
            if seen and len(seen) != size:
                self.not_derived = self.not_derived or (
                    f"observations have {len(seen) // 4} numbers, policy {self.policy.spec.name!r} makes {size // 4}: "
                    "another version's, or recorded without what it remembers (the state of an LSTM)"
                )
            return
        action = codec.parse_f32(done)
        if seen is not None:
            observation = codec.parse_f32(seen)
            self._derive(number, step, given, observation)
            self.actions.add(number, action, self.policy.act(observation))
        elif given is not None:
            self._act_unseen(number, given, action)
        self.targets.on_step(number, step, told, self.policy, given, action)
        self._before = step
        self._listen(listening, given)

    def _choose(self, step: Step, told: GateTold) -> str:
        """Take the policy that drove in a step; return the name of the one that listened, or ""."""
        driving, listening = self.names[0], ""
        if len(self.names) > 1:
            driving = told.policy if told.policy in self.names else self._driving or driving
            listening = told.next_policy if told.next_policy in self.names else ""
        if driving not in (self._driving, self._heard):
            self._before = None  # what it had seen before it drove is not known
        self._knows_past |= driving != self._driving and driving == self._heard
        if driving not in self.drove:
            self.drove.append(driving)
            followed = command_format(self.load(driving).spec.command, self.robot)
            self._command_size = len(followed.default)
        self._driving, self.policy = driving, self.load(driving)
        return listening

    def _listen(self, name: str, known: tuple[RobotState, Floats] | None) -> None:
        """Have the policy that is to take over observe and act too, as it did beside the one that drove."""
        begins = name != self._next
        is_heard = bool(name) and (self._next == "" if begins else self._heard == name)
        is_heard = is_heard and known is not None and _suits(known[0], self.load(name))
        given = known if is_heard else None
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
        if len(velocity := step.values.get(keys.root_velocity(self.robot), b"")) == 8 * 3:
            state = replace(state, root_lin_vel=codec.parse_f64(velocity))
        return (state, codec.parse_f64(used)) if _suits(state, self.policy) else None

    def _derive(self, number: int, step: Step, given: tuple[RobotState, Floats] | None, observation: Floats32) -> None:
        """Compare the observation with one made from state and command; the recorded one is the history in any case."""
        is_next = self._before is not None
        self.segments += not is_next
        if given is None:
            self.not_derived = (
                self.not_derived or f"step {number} has no {self._lacks(step)} that fits what the key holds"
            )
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

    def _lacks(self, step: Step) -> str:
        """Return the key that a step would need to be derived."""
        if steps.robot_state(self.state, step.values.get(keys.robot_state(self.robot), b"")) is None:
            return keys.robot_state(self.robot)
        has_used = len(step.values.get(keys.command_used(self.robot), b"")) == 8 * self._command_size
        return keys.root_velocity(self.robot) if has_used else keys.command_used(self.robot)

    def _act_unseen(self, number: int, given: tuple[RobotState, Floats], action: Floats32) -> None:
        """Compare the action of a step whose observation was not recorded with that of the one that is derived.

        Where the past is not known, a policy that begins is tried: at the start of an episode, and after an operator's
        reset, it knows none. What comes of another past is no difference. Behind one that is, the past is not known.
        """
        is_next = self._before is not None
        self.segments += not is_next
        self._knows_past = self._knows_past and is_next
        derived = self.policy.act(self.policy.observe(*given)) if self._knows_past else None
        if derived is None or derived.tobytes() != action.tobytes():
            self.policy.reset()
            fresh = self.policy.act(self.policy.observe(*given))
            if fresh.tobytes() == action.tobytes():
                derived, self._knows_past = fresh, True
            elif derived is not None:
                self._knows_past = False
        if derived is not None:
            self.actions.add(number, action, derived)
        else:
            self.past_unknown += 1


def _suits(state: RobotState, policy: Policy) -> bool:
    """Whether a state has all that a policy needs of it."""
    return state.root_lin_vel is not None or not policy.spec.needs_root_velocity


def _follows(before: Step, after: Step) -> bool:
    return (
        before.source == after.source
        and after.number == before.number + 1
        and after.state_number == before.state_number + 1
    )
