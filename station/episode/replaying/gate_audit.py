"""Auditing the gate of a robot with a policy: its recorded commands go through it again, bit for bit.

What the gate made of a command follows from the commands, from when they came, and from its own past. All of it is in a
recording: the number of the command and when it came stand in the timing of a step, and the age that the gate told
gives the instant of the step back to the last bit, as long as both are of one clock. What does not follow from the
recording is not compared: it is counted, by why.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec
import numpy as np

from station.bus import codec, keys
from station.command_formats import command_format
from station.contract import TIMING_STAGES, Contract, names_of
from station.control.command_validator import Checked, check_command
from station.control.envelope import Envelope, from_stated, of_parts
from station.control.gate import LATCHED, Gate, GateConfig
from station.episode.reading.messages import Message
from station.episode.reading.steps import Step, robot_state, timing_row
from station.episode.replaying.comparison import Comparison
from station.episode.storage.anchor import Anchor
from station.errors import ConfigError, UnknownName
from station.parts import PartedCommand, part_name, parts_of, rests_on_joints
from station.protocols import CommandFormat, Floats

_RESETS = ("operator-reset", "robot-reset")
_REMEMBERED = 4096  # commands, of all writers: more than a minute
_SEQUENCE_MASK = 0xFFFFFFFF
_ROUNDING = 1e-9  # [s]: ten ticks of 0.02 s are 0.2 s
_TICK, _SEQ = 0, 1
_WRITTEN, _ARRIVED, _READ = (
    2 + TIMING_STAGES.index(stage) for stage in ("command_written", "command_arrived", "state_read")
)

_IN_THE_MIDDLE = "begins in the middle of what the gate did"
_NO_COMMAND = "its command is not in the file"
_SEVERAL = "several writers used one number, and none of them wrote then"
_NO_NUMBER = "its command is of a writer that does not number what it writes"
_NO_INSTANT = "its instant is not in the file"
_NO_REST = "where it rested is not in the file"
_INCOMPLETE = "it lacks a timing, a state of the gate or a command that fits"


class GateTold(msgspec.Struct, frozen=True):
    """What a step's `command_gate` tells (`station.control.command_path.CommandPath.status`), as far as needed."""

    state: str = ""
    age_s: float | None = None
    limited: int | None = None
    beyond_envelope: int = 0
    needs_silence: str = ""
    arming: str = ""
    policy: str = ""
    next_policy: str = ""


def gate_told(step: Step, robot: str) -> GateTold:
    """Return the gate's recorded status of a step; empty where the file has none that can be read."""
    try:
        return codec.parse_struct(step.values.get(keys.command_gate(robot), b"{}"), GateTold)
    except codec.BadValue:
        return _NOTHING


_NOTHING = GateTold()


class GateSetting(NamedTuple):
    """What a gate was set to.

    Attributes:
        command_format: Of its commands.
        config: Its times.
        period_s: Of a tick in lock-step, whose clock is that of the ticks [s]; None by the wall clock.
        envelopes: Of the policies that followed it.
    """

    command_format: CommandFormat
    config: GateConfig
    period_s: float | None
    envelopes: Sequence[Envelope] = ()


def setting(facts: Mapping[str, Any], command: str) -> GateSetting | str:
    """Return how the gate of a robot was set, by what its server stated; in words why that is not known.

    Args:
        facts: Of the server.
        command: Registered name of the commands that the policy follows.
    """
    try:
        span = facts.get("command_range") or {}  # of a format for any robot
        followed = command_format(command, str(facts.get("robot", "")), span.get("lower"), span.get("upper"))
        config = msgspec.convert(facts["gate"], GateConfig)
        rates = facts["rates"]
        period_s = 1.0 / float(rates["control_hz"]) if rates.get("pace") == "command" else None
        envelopes = stated_envelopes(facts)
        of_parts(envelopes, parts_of(followed))
    except (UnknownName, ConfigError) as error:
        return str(error)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError, msgspec.ValidationError):
        return "the manifest does not say how the gate was set"
    return GateSetting(followed, config, period_s, envelopes)


def stated_envelopes(facts: Mapping[str, Any]) -> tuple[Envelope, ...]:
    """Return the envelopes of a robot's policies, by what its server stated; none of a server that knew of none.

    Raises:
        ConfigError: they cannot be read.
    """
    try:
        return tuple(map(from_stated, facts.get("envelopes", ())))
    except (msgspec.MsgspecError, TypeError) as error:
        raise ConfigError(f"the manifest does not say which envelope the gate kept to: {error}") from None


@dataclass
class GateReplay:
    """Follows the steps of an episode with a gate of our own.

    Attributes:
        robot: Suffix of the keys of the gate: the robot's, or that of a part that is commanded apart.
        of: How the gate was set.
        anchor: Clock of the file; None where it says none.
        is_part: Whether it is that of a part, whose steps say the instant too (`keys.command_timing`).
        rest: Where the joints of what rests on them are in a step; None for what does not.
        commands: What the gate let through, derived and recorded.
        states: What state it was in, likewise.
        not_proven: How many steps were not compared, by why.
    """

    robot: str
    of: GateSetting
    anchor: Anchor | None
    is_part: bool = False
    rest: Rest | None = None
    commands: Comparison = field(default_factory=Comparison)
    states: Comparison = field(default_factory=Comparison)
    not_proven: Counter[str] = field(default_factory=Counter)
    _written: OrderedDict[int, list[Message]] = field(default_factory=OrderedDict)
    _resets: set[str] = field(default_factory=set)  # sources of servers that told of one since the last step
    _gate: Gate | None = None  # None: what it was in is not known
    _before: Step | None = None
    _was_reset: bool = False  # in the step before
    _state_before: str = ""
    _tracking_since_s: float | None = None
    _source: str | None = None  # of the command of the step before
    _used: tuple[tuple[int, int], Message, Floats | None] | None = None  # number and instant of the newest command

    def on_command(self, message: Message) -> None:
        """Remember a command."""
        if message.channel.is_native:
            self._written.setdefault(message.sequence, []).append(message)
            if len(self._written) > _REMEMBERED:
                self._written.popitem(last=False)

    def on_event(self, message: Message) -> None:
        """Remember that a robot was put on its feet, or its gate was reset."""
        if codec.parse_facts(message.data).get("name") in _RESETS:
            self._resets.add(message.channel.source)

    def on_step(self, number: int, step: Step, told: GateTold) -> None:
        """Compare one step with its recorded gate status."""
        row, now_s = self._row(step, told)
        data, state = step.values.get(keys.command_used(self.robot)), told.state
        follows_on = self._before is not None and (step.source, step.number) == (
            self._before.source,
            self._before.number + 1,
        )
        was_reset = step.source in self._resets
        self._resets.clear()
        before = self._before if follows_on and not (was_reset or self._was_reset) else None
        self._before, self._was_reset = step, was_reset
        if row is None or not state or data is None or len(data) != 8 * len(self._default):
            self._lose(_INCOMPLETE)
            return
        used = codec.parse_f64(data)
        if not follows_on:
            self._gate, self._tracking_since_s = None, None
        was_latched, self._state_before = self._state_before in LATCHED, state
        self._tracking_since_s = None if state != "tracking" else self._tracking_since_s or now_s
        is_at_rest = self._gate is None and (state == "waiting" or row[_TICK] == 1)
        if was_reset or (was_latched and state not in LATCHED) or is_at_rest:
            self._gate = self._fresh()  # it waits, and asks the robot to stand, or rests
            if is_at_rest and not was_reset and row[_TICK] > 1 and self._keeps_command:
                self._gate.rest(used)  # as high as it was asked to be before the file began
                self.not_proven[_IN_THE_MIDDLE] += 1
                return
        if self._gate is None or (told.beyond_envelope and not self._gate.knows_averages):
            self._resume(used, now_s, told, row)
            self.not_proven[_IN_THE_MIDDLE] += 1
            return
        if self.rest is not None:
            where = self.rest(step, before, is_first=row[_TICK] == 1)
            self._gate.rest(used if where is None else where)
            if where is None and state in ("waiting", *LATCHED):
                self.not_proven[_NO_REST] += 1
                if state in LATCHED:
                    self._gate.stop("as recorded")
                return
        self._derive(number, self._gate, row, told, used, now_s)

    @property
    def _default(self) -> Floats:
        return self.of.command_format.default

    def _fresh(self) -> Gate:
        return Gate.of(self.of.command_format, self.of.config, self.of.envelopes)

    @property
    def _keeps_command(self) -> bool:
        """Whether what is let through without a command is the last one, its velocities ended."""
        return self.of.command_format.holds_position and self.rest is None

    def _resume(self, used: Floats, now_s: float | None, told: GateTold, row: list[int]) -> None:
        """Go on from what the gate let through in a step, where nothing else of its past counts."""
        self._gate = None
        is_free = told.limited == 0 and not told.beyond_envelope
        if now_s is not None and told.state == "tracking" and is_free and self._is_steady(now_s):
            self._gate = self._fresh()
            self._gate.restore(used, now_s)
            command = self._command(row)
            self._source = command[0].channel.source if isinstance(command, tuple) else None

    def _is_steady(self, now_s: float) -> bool:
        """Whether no velocity can be on its way back from a hold."""
        if not self.of.command_format.velocities:
            return True
        since_s = self._tracking_since_s
        return since_s is not None and now_s - since_s >= self.of.config.velocity_fade_s - _ROUNDING

    def _derive(
        self, number: int, gate: Gate, row: list[int], told: GateTold, used: Floats, now_s: float | None
    ) -> None:
        age_s, state = told.age_s, told.state
        vector, is_refused = None, False
        if state in LATCHED:
            gate.stop("as recorded")
        elif age_s is not None and not told.needs_silence:
            found = self._command(row)
            if isinstance(found, str):
                self._lose(found)
                return
            message, vector = found
            is_refused = vector is None
            if self._source not in (None, message.channel.source):
                gate.change_hands("another commands")
            self._source = message.channel.source
        if now_s is None:
            if self.rest is not None or state not in ("waiting", *LATCHED):
                self._lose(_NO_INSTANT)
                return
            now_s = row[_READ] * 1e-9  # nothing moves by then, so it does not matter
        if is_refused:  # what no gate lets through was let through
            self.commands.add(number, used, np.full(len(used), np.nan))
            self._resume(used, now_s, told, row)
            return
        age = math.inf if vector is None or age_s is None else age_s
        decision = gate.step(now_s, vector, age, delay_s=self._delay_s(row))
        is_same_state = self.states.add_state(number, state, decision.state)
        if not (self.commands.add(number, used, decision.vector) and is_same_state):
            self._resume(used, now_s, told, row)  # what follows is not compared with what is wrong already

    def _lose(self, why: str) -> None:
        self.not_proven[why] += 1
        self._gate = None

    def _row(self, step: Step, told: GateTold) -> tuple[list[int] | None, float | None]:
        """Return timing of a step, and the instant that its gate was given [s]; None for what is not in the file."""
        if not self.is_part:
            row = timing_row(step.values.get(keys.policy_timing(self.robot)))
            return row, None if row is None else self._now_s(row, told)
        try:
            *row, now_s = codec.parse_struct(
                step.values.get(keys.command_timing(self.robot), b""), tuple[int, int, int, int, float]
            )
        except codec.BadValue:
            return None, None
        return row, now_s

    def _now_s(self, row: list[int], told: GateTold) -> float | None:
        """Return the instant that the gate was given [s]; None where that is not known to the last bit.

        The age is the difference of two instants that lie near each other, so it is exact, and so is this sum.
        """
        if self.of.period_s is not None:
            return (row[_TICK] - 1) * self.of.period_s
        return row[_ARRIVED] * 1e-9 + told.age_s if row[_ARRIVED] and told.age_s is not None else None

    def _delay_s(self, row: list[int]) -> float:
        is_known = self.of.period_s is None and row[_WRITTEN] > 0 and row[_ARRIVED] > 0
        return (row[_ARRIVED] - row[_WRITTEN]) * 1e-9 if is_known else 0.0

    def _command(self, row: list[int]) -> tuple[Message, Floats | None] | str:
        """Return the command that a step used, and its numbers, None where it is no good one; in words why not."""
        seq, written_ns = row[_SEQ], row[_WRITTEN]
        if self._used is not None and self._used[0] == (seq, written_ns):
            return self._used[1:]
        if not seq:
            return _NO_NUMBER
        found = self._written.get(seq & _SEQUENCE_MASK, [])
        if len(found) > 1:
            at_ns = self.anchor.at(written_ns) if self.anchor is not None else 0
            if not (found := [message for message in found if message.publish_ns == at_ns]):
                return _SEVERAL
        if not found:
            return _NO_COMMAND
        checked = check_command(found[-1].data, self.of.command_format)
        vector = checked.vector if isinstance(checked, Checked) else None
        self._used = ((seq, written_ns), found[-1], vector)
        return found[-1], vector


@dataclass(frozen=True)
class Rest:
    """Where joints rest that no command moves: where they were asked to be in the step before; where they are, if none.

    Attributes:
        robot: Suffix of the robot's keys.
        part: That of the part's keys, where its command is one of several.
        state: What `keys.robot_state` holds.
        joints: Places of the joints among the robot's.
    """

    robot: str
    part: str
    state: Contract
    joints: list[int]

    def __call__(self, step: Step, before: Step | None, *, is_first: bool) -> Floats | None:
        """Return the positions in a step, shape (n,) [rad]; None where they are not in the file.

        Args:
            step: The step.
            before: The one before it, None where that is not in the file or the robot was put elsewhere in it.
            is_first: Whether there was none.
        """
        state = robot_state(self.state, step.values.get(keys.robot_state(self.robot), b""))
        if state is None or (before is None and not is_first):
            return None
        count = len(state.q)
        if before is None or self._was_limp(before, count):
            return state.q[self.joints]
        used = before.values.get(keys.command_used(self.part), b"")
        return codec.parse_f64(used) if len(used) == 8 * len(self.joints) else None

    def _sent(self, step: Step) -> Floats:
        return codec.parse_f64(step.values.get(keys.target(self.robot), b""))

    def _was_limp(self, step: Step, count: int) -> bool:
        """Whether no positions were asked for: disarmed, stopped, or damped for a fault."""
        told, sent = gate_told(step, self.robot), self._sent(step)
        is_damped = len(sent) != 3 * count or not sent[count : 2 * count].any()
        return told.state in LATCHED or told.arming == "disarmed" or (is_damped and told.arming != "arming")


class GatesReplay:
    """The gates of a robot: one, or one for each part that is commanded apart.

    Args:
        robot: Suffix of its keys.
        gates: By the name of what each is of; "" for that of all of the robot.

    Attributes:
        wholes: Where there are parts: what the policy got, and what the gates of the parts let through.
    """

    def __init__(self, robot: str, gates: Mapping[str, GateReplay]) -> None:
        self.gates, self.wholes, self._robot = gates, Comparison(), robot

    @property
    def parts(self) -> list[str]:
        """Suffixes of the parts' keys; none where there is but one gate."""
        return [gate.robot for gate in self.gates.values() if gate.robot != self._robot]

    @property
    def command_keys(self) -> list[str]:
        """Of the commands."""
        return [gate.of.command_format.key for gate in self.gates.values()]

    @property
    def followed(self) -> list[Comparison]:
        """All that is compared."""
        return [*self.commands, *(gate.states for gate in self.gates.values())]

    @property
    def commands(self) -> list[Comparison]:
        """What was let through."""
        return [*([self.wholes] if self.parts else []), *(gate.commands for gate in self.gates.values())]

    @property
    def not_proven(self) -> dict[str, int]:
        """How many steps were not compared, by why."""
        return {
            f"{name}: {why}" if name else why: count
            for name, gate in self.gates.items()
            for why, count in gate.not_proven.items()
        }

    def on_message(self, message: Message) -> None:
        """Remember a command, or what a server told."""
        for gate in self.gates.values():
            if message.topic == gate.of.command_format.key:
                gate.on_command(message)
            elif message.topic == keys.EVENT:
                gate.on_event(message)

    def on_step(self, number: int, step: Step) -> None:
        """Compare one step."""
        for gate in self.gates.values():
            gate.on_step(number, step, gate_told(step, gate.robot))
        used = [step.values.get(keys.command_used(part), b"") for part in self.parts]
        if used and (whole := step.values.get(keys.command_used(self._robot))) is not None:
            self.wholes.add(number, codec.parse_f64(whole), codec.parse_f64(b"".join(used)))


def replay(
    robot: str, facts: Mapping[str, Any], command: str, anchor: Anchor | None, state: Contract | None
) -> GatesReplay | str:
    """Return what replays the gate of a robot, or those of its parts; in words why it cannot be.

    Args:
        robot: Suffix of its keys.
        facts: Of its server.
        command: Registered name of the commands that its policy follows.
        anchor: Clock of the file; None where it says none.
        state: What its `keys.robot_state` holds.
    """
    found = setting(facts, command)
    if isinstance(found, str):
        return found
    whole, made = found.command_format, dict[str, GateReplay]()
    parts = parts_of(whole)
    for part, own in zip(parts, of_parts(found.envelopes, parts), strict=True):
        name = part_name(whole, part) if isinstance(whole, PartedCommand) else ""
        rest = _rest(robot, part, state)
        if isinstance(rest, str):
            return rest
        of = found._replace(command_format=part, envelopes=own)
        made[name] = GateReplay(part.robot, of, anchor, bool(name), rest)
        try:
            made[name]._fresh()
        except ConfigError as error:
            return f"the gate cannot be set as it was: {error}"
    return GatesReplay(robot, made)


def _rest(robot: str, of: CommandFormat, state: Contract | None) -> Rest | str | None:
    """Return where the joints of a command rest, None where it has none that do; in words why that is not known."""
    if not rests_on_joints(of):
        return None
    joints = [name for name in (state.names if state is not None else ()) if name.endswith("_pos")]
    names = names_of(of.elements)
    if state is None or not set(names) <= set(joints):
        return "without a command it rests where it is, which is not in the file"
    return Rest(robot, of.robot, state, [joints.index(name) for name in names])
