"""Auditing an arm's episode: its commands go through the gate again, and what comes out is compared bit for bit.

An arm has no policy; what decides its motion is the gate. Two questions. Do the recorded commands, at the recorded
instants, give the recorded commands after the gate, and its states? And do those, with the recorded joints, give the
recorded targets? With two times yes, the file holds everything that decided what was asked of the controller.

Where no command was followed nothing is derived: the next derivation begins at the recorded place of the arm. Where the
controller's session refused a target, its refusal stands in the file, and the target before holds on.
"""

from __future__ import annotations

from array import array
from collections import OrderedDict
from dataclasses import dataclass, field

import msgspec
import numpy as np

from station.arms import JointCommand
from station.bus import codec, keys
from station.contract import TIMING_STAGES
from station.control.arm_control import aim
from station.control.command_validator import Checked, check_command
from station.control.gate import FOLLOWING, MOVING, Bounds, Gate, GateConfig
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step, StepJoiner, timing_row
from station.episode.replaying.comparison import Comparison
from station.errors import ConfigError, EpisodeError
from station.protocols import Floats

_REMEMBERED = 4096  # commands, of all writers: some seconds
_WRITTEN, _ARRIVED, _OBSERVED = (
    2 + TIMING_STAGES.index(stage) for stage in ("command_written", "command_arrived", "observed")
)


class ArmAudit(msgspec.Struct, kw_only=True):
    """What an audit of an arm found.

    Attributes:
        episode_id, robot: What was audited.
        steps: Ticks in the file.
        followed: Those in which a command was followed.
        commands: Commands after the gate, derived and recorded.
        states_different, first_state_different_s: Followed ticks whose derived state of the gate is another, and when
            the first was, from the start of the episode [s].
        command_key: Key of the commands that went through the gate again.
        targets: Targets, derived and recorded, in the ticks whose joints are in the file.
        refused: Ticks in which the controller's session refused to be engaged, or a target.
        segments: Runs of followed ticks without a missing one; derivation starts anew at each.
        incomplete: Followed ticks that cannot be derived: their command is not in the file, or had no number.
    """

    episode_id: str
    robot: str
    steps: int = 0
    followed: int = 0
    commands: Comparison = msgspec.field(default_factory=Comparison)
    states_different: int = 0
    first_state_different_s: float | None = None
    command_key: str = ""
    targets: Comparison = msgspec.field(default_factory=Comparison)
    refused: int = 0
    segments: int = 0
    incomplete: int = 0

    @property
    def is_equal(self) -> bool:
        """Whether commands and targets were compared, and every bit of them is the same."""
        differ = self.commands.different + self.targets.different + self.states_different
        return self.commands.compared > 0 and self.targets.compared > 0 and not differ


def is_arm(reader: EpisodeReader, robot: str) -> bool:
    """Whether a robot of an episode has a controller of its own, and no policy between its command and its targets."""
    topics = set(reader.topics())
    of_arms = {keys.action_joints(robot), keys.state_joints(robot)}
    of_policies = {keys.policy_obs(robot), keys.policy_action(robot)}
    return not of_policies & topics and keys.target(robot) in topics and bool(of_arms & topics)


def audit_arm(reader: EpisodeReader, robot: str) -> ArmAudit:
    """Derive an arm's targets again from its recorded commands, and compare.

    Raises:
        EpisodeError: the episode does not say what the arm's command and gate were.
    """
    command_format, config = _stated(reader, robot)
    found = ArmAudit(episode_id=reader.episode_id, robot=robot, command_key=command_format.key)
    run = _Run(found, command_format, config)
    joiner = StepJoiner(robot, context={keys.state_controller(robot)})
    for message in reader.messages({*joiner.topics, command_format.key}):
        if message.topic == command_format.key:
            run.on_command(message)
        elif (step := joiner.feed(message)) is not None:
            run.on_step(step)
    for step in joiner.finish():
        run.on_step(step)
    run.place(reader.start_ns)
    return found


def _stated(reader: EpisodeReader, robot: str) -> tuple[JointCommand, GateConfig]:
    facts = next((one for one in reader.manifest.servers.values() if one.get("robot") == robot and "gate" in one), {})
    stated = facts.get("command")
    names = ("lower", "upper", "margin", "rate")
    try:
        arrays = {name: np.array(stated[name], dtype=np.float64) for name in names} if isinstance(stated, dict) else {}
        count = len(arrays["lower"]) if arrays and arrays["lower"].ndim == 1 else 0
        if not count or any(array.shape != (count,) or not np.isfinite(array).all() for array in arrays.values()):
            raise ValueError("its limits are not one number for each joint")
        description = reader.known.robot(robot)
        joints = description.joint_names if description is not None else ()
        if len(joints) != count:
            raise ValueError(f"it has limits of {count} joints, and its description names {len(joints)}")
        lower, upper, margin, rate = (arrays[name] for name in names)
        command = JointCommand.within("audit", robot, joints, lower=lower, upper=upper, margin=margin, rate=rate)
        return command, msgspec.convert(facts.get("gate"), GateConfig)
    except (KeyError, TypeError, ValueError, msgspec.ValidationError, ConfigError) as error:
        raise EpisodeError(
            f"episode {reader.episode_id}: its manifest does not say how commands of {robot} were limited ({error}); "
            "it cannot be audited"
        ) from None


@dataclass
class _Run:
    """Follows the ticks of an episode with a gate of our own."""

    found: ArmAudit
    command_format: JointCommand
    config: GateConfig
    _states: Comparison = field(default_factory=Comparison)
    _times: array[int] = field(default_factory=lambda: array("q"))  # of every tick [ns]
    _commands: OrderedDict[int, list[Message]] = field(default_factory=OrderedDict)
    _before: Step | None = None
    _held: Floats | None = None  # the target of the tick before, where a command was followed in it
    _source: str = ""

    def __post_init__(self) -> None:
        bounds = Bounds.of(self.command_format, self.config.rate_factor)
        self._gate = Gate(self.command_format.default, self.config, bounds, holds_position=True)

    def place(self, start_ns: int) -> None:
        """Say when the first difference of each kind was, by the start of the episode [ns since the epoch]."""
        for compared in (self.found.commands, self.found.targets, self._states):
            compared.place(self._times, start_ns)
        self.found.states_different = self._states.different
        self.found.first_state_different_s = self._states.first_different_s

    def on_command(self, message: Message) -> None:
        """Remember a command."""
        self._commands.setdefault(message.sequence, []).append(message)
        if len(self._commands) > _REMEMBERED:
            self._commands.popitem(last=False)

    def on_step(self, step: Step) -> None:
        """Compare one tick."""
        found, robot = self.found, self.found.robot
        found.steps += 1
        number = found.steps - 1
        self._times.append(step.at_ns)
        row = timing_row(step.values.get(keys.policy_timing(robot)))
        gate = codec.parse_facts(step.values.get(keys.command_gate(robot)))
        used, target = _vector(step, keys.command_used(robot)), _vector(step, keys.target(robot))
        state, refusal = gate.get("state"), gate.get("target_refused")
        if used is None or target is None or row is None:
            self._before, self._held, found.incomplete = None, None, found.incomplete + 1
            return
        now_s = row[_OBSERVED] * 1e-9
        follows_on = self._before is not None and step.number == self._before.number + 1
        is_new_state = self._before is not None and step.state_number != self._before.state_number
        self._before = step
        held, self._held = self._held, target if state in FOLLOWING else None
        found.refused += bool(refusal)
        if state not in FOLLOWING or not follows_on:
            self._rest(used, now_s)
            return
        found.followed += 1
        found.segments += self._gate.state not in FOLLOWING
        self._derive(number, row, used, str(state))
        if is_new_state and state in MOVING:
            self._compare_target(number, step, used, target, str(refusal or ""), held)

    def _rest(self, where: Floats, now_s: float) -> None:
        """Begin anew from where the arm is."""
        self._gate.reset()
        self._gate.rest(where)
        self._gate.step(now_s, None, np.inf)

    def _derive(self, number: int, row: list[int], used: Floats, state: str) -> None:
        now_s = row[_OBSERVED] * 1e-9
        command = self._command(row[1], row[_ARRIVED])
        if command is None:
            self.found.incomplete += 1
            self._gate.reset()
            self._gate.rest(used)
            self._gate.step(now_s, used, 0.0)
            return
        delay_s = (row[_ARRIVED] - row[_WRITTEN]) * 1e-9 if row[_WRITTEN] else 0.0
        decision = self._gate.step(now_s, command, now_s - row[_ARRIVED] * 1e-9, delay_s=delay_s)
        self.found.commands.add(number, used, decision.vector)
        self._states.add_state(number, state, decision.state)

    def _command(self, seq: int, arrived_ns: int) -> Floats | None:
        """Return the command of a number: of several writers' the one that a good one of them wrote last."""
        for message in reversed(self._commands.get(seq, [])):
            checked = check_command(message.data, self.command_format)
            if isinstance(checked, Checked) and arrived_ns:
                if self._source and message.channel.source != self._source:
                    self._gate.change_hands("another commands")
                self._source = message.channel.source
                return checked.vector
        return None

    def _compare_target(
        self, number: int, step: Step, used: Floats, target: Floats, refusal: str, held: Floats | None
    ) -> None:
        robot = self.found.robot
        joints = _vector(step, keys.state_joints(robot), size=21)
        lead = codec.parse_facts(step.before.get(keys.state_controller(robot))).get("lead_rad")
        if joints is None or not isinstance(lead, float):
            return
        q = joints[:7]
        kept = q if held is None else held  # what holds where a target was refused: the joints, where it is the first
        self.found.targets.add(number, target, kept if refusal else aim(used, q, lead))


def _vector(step: Step, key: str, size: int = 7) -> Floats | None:
    data = step.values.get(key)
    return codec.parse_f64(data) if data is not None and len(data) == 8 * size else None
