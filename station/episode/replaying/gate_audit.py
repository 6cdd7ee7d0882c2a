"""Auditing the gate of a robot with a policy: its recorded commands go through it again, bit for bit.

What the gate made of a command follows from the commands, from when they came, and from its own past. All of it is in a
recording: the number of the command and when it came stand in the timing of a step, and the age that the gate told
gives the instant of the step back to the last bit, as long as both are of one clock. What does not follow from the
recording is not compared: it is counted, by why.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec
import numpy as np

from station.bus import codec, keys
from station.command_formats import command_format
from station.contract import TIMING_STAGES
from station.control.command_validator import Checked, check_command
from station.control.gate import LATCHED, Bounds, Gate, GateConfig
from station.episode.reading.messages import Message
from station.episode.reading.steps import Step, timing_row
from station.episode.replaying.comparison import Comparison
from station.episode.storage.anchor import Anchor
from station.errors import ConfigError, UnknownName
from station.parts import PartedCommand
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
_INCOMPLETE = "it lacks a timing, a state of the gate or a command that fits"


class GateTold(msgspec.Struct, frozen=True):
    """What a step's `command_gate` tells (`station.control.command_path.CommandPath.status`), as far as needed."""

    state: str = ""
    age_s: float | None = None
    limited: int | None = None
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
    """

    command_format: CommandFormat
    config: GateConfig
    period_s: float | None


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
    except (UnknownName, ConfigError) as error:
        return str(error)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError, msgspec.ValidationError):
        return "the manifest does not say how the gate was set"
    if isinstance(followed, PartedCommand):
        return "its parts are commanded apart"
    if followed.holds_position:
        return "without a command it rests where it is, which is not in the file"
    return GateSetting(followed, config, period_s)


@dataclass
class GateReplay:
    """Follows the steps of an episode with a gate of our own.

    Attributes:
        robot: Suffix of its keys.
        of: How the gate was set.
        anchor: Clock of the file; None where it says none.
        commands: What the gate let through, derived and recorded.
        states: What state it was in, likewise.
        not_proven: How many steps were not compared, by why.
    """

    robot: str
    of: GateSetting
    anchor: Anchor | None
    commands: Comparison = field(default_factory=Comparison)
    states: Comparison = field(default_factory=Comparison)
    not_proven: Counter[str] = field(default_factory=Counter)
    _written: OrderedDict[int, list[Message]] = field(default_factory=OrderedDict)
    _resets: set[str] = field(default_factory=set)  # sources of servers that told of one since the last step
    _gate: Gate | None = None  # None: what it was in is not known
    _before: Step | None = None
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
        row = timing_row(step.values.get(keys.policy_timing(self.robot)))
        data, state = step.values.get(keys.command_used(self.robot)), told.state
        follows_on = self._before is not None and (step.source, step.number) == (
            self._before.source,
            self._before.number + 1,
        )
        was_reset = step.source in self._resets
        self._resets.clear()
        self._before = step
        if row is None or not state or data is None or len(data) != 8 * len(self._default):
            self._lose(_INCOMPLETE)
            return
        used, now_s = codec.parse_f64(data), self._now_s(row, told)
        if not follows_on:
            self._gate, self._tracking_since_s = None, None
        was_latched, self._state_before = self._state_before in LATCHED, state
        self._tracking_since_s = None if state != "tracking" else self._tracking_since_s or now_s
        is_at_rest = self._gate is None and (state == "waiting" or row[_TICK] == 1)
        if was_reset or (was_latched and state not in LATCHED) or is_at_rest:
            self._gate = self._fresh()  # it waits, and asks the robot to stand
        if self._gate is None:
            self._resume(used, now_s, told, row)
            self.not_proven[_IN_THE_MIDDLE] += 1
            return
        self._derive(number, self._gate, row, told, used, now_s)

    @property
    def _default(self) -> Floats:
        return self.of.command_format.default

    def _fresh(self) -> Gate:
        command_format, config = self.of.command_format, self.of.config
        bounds = Bounds.of(command_format, config.rate_factor)
        return Gate(command_format.default, config, bounds, velocities=command_format.velocities)

    def _resume(self, used: Floats, now_s: float | None, told: GateTold, row: list[int]) -> None:
        """Go on from what the gate let through in a step, where nothing else of its past counts."""
        self._gate = None
        if now_s is not None and told.state == "tracking" and told.limited == 0 and self._is_steady(now_s):
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
            if state not in ("waiting", *LATCHED):
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


def replay(robot: str, facts: Mapping[str, Any], command: str, anchor: Anchor | None) -> GateReplay | str:
    """Return what replays the gate of a robot; in words why it cannot be."""
    found = setting(facts, command)
    if isinstance(found, str):
        return found
    try:
        made = GateReplay(robot, found, anchor)
        made._fresh()
    except ConfigError as error:
        return f"the gate cannot be set as it was: {error}"
    return made
