"""What every robot does with a command before it acts on it: validator, gate, arming, and telling what changed.

Shared by robots that a policy moves (`station.control.control`) and by arms behind a controller of their own
(`station.control.arm_control`). Pure: no bus, no robot, no clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from station.control.arming import Arming, why_not_arm
from station.control.command_arbiter import spoken
from station.control.command_validator import CommandValidator, Samples
from station.control.envelope import Envelope
from station.control.gate import MOVING, Decision, Gate, GateConfig, QuietTime, State
from station.life.events import Severity
from station.protocols import CommandFormat

_ALARMING = ("holding", "returning", "faulted")

_CALM_S = 0.5  # a command on the edge of what is allowed is slewed now and then; that is one story


@dataclass(frozen=True, slots=True)
class StepEvent:
    """Something that happened within a step, for an event on the bus."""

    name: str
    severity: Severity
    detail: dict[str, Any]


class CommandPath:
    """The command's way to the robot, up to what the gate lets through.

    Args:
        command_format: Format of the command.
        config: Times of the gate.
        arming: Of the robot.
        part: Name of the part that it is about, for its events; "" for all of the robot.
        step_events: Where to put what happened; a list of its own without it.
        envelopes: Of the policies that follow it.

    Attributes:
        command_format, gate, validator, arming: What it is made of.
    """

    def __init__(
        self,
        command_format: CommandFormat,
        config: GateConfig,
        arming: Arming,
        *,
        part: str = "",
        step_events: list[StepEvent] | None = None,
        envelopes: Sequence[Envelope] = (),
    ) -> None:
        self.command_format, self.part = command_format, part
        self.gate = Gate.of(command_format, config, envelopes)
        self.validator = CommandValidator(command_format, config.longest_delay_s)
        self.arming = arming
        self._refusing: str | None = None
        self._rival = ""  # why another writer's command was refused in this step
        self._heard_s = (-math.inf, math.inf)  # offline everything is known
        self._slewing = Limiting("command-slewed", command_format)
        self._clamping = Limiting("command-clamped", command_format)
        self._surviving = Limiting("command-beyond-envelope", command_format)
        self._step_events: list[StepEvent] = [] if step_events is None else step_events

    @property
    def paths(self) -> tuple[CommandPath, ...]:
        """Each with a key of its own; here the one."""
        return (self,)

    @property
    def state(self) -> State:
        """The gate's."""
        return self.gate.state

    @property
    def reason(self) -> str:
        """Why the gate is in its state."""
        return self.gate.reason

    def decide(self, sample: Samples, now_s: float, *, why_blocked: str = "") -> Decision:
        """Read the newest command and return what the gate lets through.

        Args:
            sample: The newest write of the command key, good or bad; the same object as long as nothing new came.
            now_s: The instant, on the clock of `CommandSample.arrived_s` [s].
            why_blocked: Why no command may be followed now, or "".
        """
        sample = sample[0] if isinstance(sample, tuple) else sample
        validator, before = self.validator, self.validator.good
        if validator.update(sample):
            self._report_refusal()
        if before is not None and validator.good is not None and before.source != validator.good.source:
            self.gate.change_hands(f"{spoken(validator.good.source)} commands in place of {spoken(before.source)}")
        refusal = self._rival if validator.refusal is None else f"{validator.refusal.kind}: {validator.refusal.text}"
        quiet = self._quiet(now_s)
        self._rival = ""
        vector, age_s = validator.vector, validator.age_s(now_s)
        if why_blocked:
            vector, refusal = None, why_blocked
        decision = self.gate.step(now_s, vector, age_s, delay_s=validator.delay_s, refusal=refusal, quiet=quiet)
        for change in decision.transitions:
            severity: Severity = "warning" if change.after in _ALARMING else "info"
            self.add_event("gate", severity, **{"from": change.before, "to": change.after, "reason": change.reason})
        clamped = validator.clamped if decision.state in MOVING else ()
        for name, detail in self._clamping.on_tick(clamped, now_s):
            self.add_event(name, "warning", **detail, allowed=self._allowed(clamped))
        for name, detail in self._surviving.on_tick(decision.beyond, now_s):
            self.add_event(name, "warning", **detail)
        for name, detail in self._slewing.on_tick(decision.limited, now_s):
            self.add_event(name, "warning", **detail)
        return decision

    def stop(self, reason: str) -> None:
        """Latch the emergency stop."""
        if self.state != "stopped":
            for path in self.paths:
                path.gate.stop(reason)
            self.add_event("estop", "error", reason=reason)

    def reset(self, reason: str) -> None:
        """Leave the stop, a fault, and any other state: wait for commands that begin anew."""
        for path in self.paths:
            path.gate.reset(reason)

    def why_not_arm(self, now_s: float) -> str:
        """Return why the robot may not be armed now, or ""."""
        for path in self.paths:
            if refusal := why_not_arm(path.gate, path.validator, now_s):
                return f"{path.part}: {refusal}" if path.part and path.gate.state != "stopped" else refusal
        return ""

    def arm(self, now_s: float, who: str, refusal: str) -> str:
        """Begin to arm, unless there is a reason not to; return that reason, or ""."""
        if refusal:
            self.add_event("arm-refused", "warning", who=who, reason=refusal)
        elif self.arming.state == "disarmed":
            self.arming.arm(now_s)
            self.add_event("arming", "warning", who=who, ramp_s=self.arming.ramp_s)
        return refusal

    def disarm(self, who: str = "") -> None:
        """Send nothing to the robot from the next step on."""
        if self.arming.state != "disarmed":
            self.arming.disarm()
            self.add_event("disarmed", "warning", who=who)

    def status(self, decision: Decision) -> dict[str, Any]:
        """Return what a robot's `command_gate` tells of a step."""
        return {
            "state": decision.state,
            "reason": decision.reason,
            "age_s": decision.age_s if math.isfinite(decision.age_s) else None,
            "clamped": len(self.validator.clamped),
            "refused": self.validator.refused.total(),
            "arming": self.arming.state,
            "limited": len(decision.limited),
            "beyond_envelope": len(decision.beyond),
            "needs_silence": self.gate.why_not_follow,
        }

    def refuse_rivals(self, count: int, reason: str) -> None:
        """Count refused commands of a second writer; call before the step that they arrived for."""
        self.validator.refused["second-writer"] += count
        self._rival = f"second-writer: {reason}"

    def heard_all(self, since_s: float, until_s: float) -> None:
        """Set the span in which every write was seen [s]; call before the step that it is about."""
        self._heard_s = since_s, until_s

    def add_event(self, name: str, severity: Severity, **detail: Any) -> None:
        """Have something told with this step."""
        of_part = {"part": self.part} if self.part else {}
        self._step_events.append(StepEvent(name, severity, of_part | detail))

    def taken(self) -> tuple[StepEvent, ...]:
        """Return what happened since the last call, in order."""
        step_events = tuple(self._step_events)
        self._step_events.clear()
        return step_events

    def _allowed(self, elements: tuple[int, ...]) -> dict[str, list[float]]:
        """Return the ranges of some elements, by name."""
        command = self.command_format
        return {command.elements[at].name: [float(command.lower[at]), float(command.upper[at])] for at in elements}

    def _quiet(self, now_s: float) -> QuietTime:
        since_s, until_s = self._heard_s
        came_s = 0.0 if self._rival else self.validator.quiet_s(now_s)
        return QuietTime(min(now_s - since_s, came_s), max(now_s - until_s, 0.0))

    def _report_refusal(self) -> None:
        """Publish once that commands are refused, again when the reason changes, and once that they are good again."""
        refusal, validator = self.validator.refusal, self.validator
        kind = refusal.kind if refusal is not None else None
        if kind == self._refusing:
            return
        total = validator.refused.total()
        if refusal is not None:
            self.add_event("refused-command", "warning", reason=f"{refusal.kind}: {refusal.text}", count=total)
        else:
            self.add_event("command-good-again", "info", count=total)
        self._refusing = kind


class Record(Protocol):
    """What every control step tells of itself."""

    @property
    def step_events(self) -> tuple[StepEvent, ...]:
        """What happened, in order."""
        ...


StateT = TypeVar("StateT")
RecordT_co = TypeVar("RecordT_co", bound=Record, covariant=True)


class Control(Protocol[StateT, RecordT_co]):
    """A control step: `station.control.control` has a robot's with a policy, `station.control.arm_control` an arm's."""

    @property
    def commanded(self) -> CommandPath:
        """The command's way to the robot."""
        ...

    def sense(self) -> StateT:
        """Return the state that the next `step` acts on."""
        ...

    def step(self, state: StateT, sample: Samples, now_s: float) -> RecordT_co:
        """Act on a state and the newest command sample, at an instant [s]."""
        ...

    def stop(self, reason: str) -> None:
        """Latch the emergency stop."""
        ...

    def reset(self, reason: str) -> None:
        """Leave the emergency stop."""
        ...

    def arm(self, now_s: float, who: str = "") -> str:
        """Begin to arm the robot; return why not, or ""."""
        ...

    def disarm(self, who: str = "") -> None:
        """Send nothing to the robot from the next step on."""
        ...

    def health(self) -> dict[str, Any]:
        """Return what a server's heartbeat tells of this robot."""
        ...


class Limiting:
    """Follows which elements of a command are limited, and tells when that begins and when it has ended.

    Args:
        event: Name of its events.
        command_format: Names the elements.
    """

    def __init__(self, event: str, command_format: CommandFormat) -> None:
        self._event, self._command_format = event, command_format
        self._ticks = 0
        self._elements: set[int] = set()
        self._last_s = 0.0

    def on_tick(self, limited: tuple[int, ...], now_s: float) -> Iterator[tuple[str, dict[str, Any]]]:
        """Record a tick; yield name and detail of an event when limiting begins and when it has ended."""
        if limited:
            if not self._ticks:
                yield self._event, {"elements": self._names(limited)}
            self._ticks, self._last_s = self._ticks + 1, now_s
            self._elements.update(limited)
        elif self._ticks and not 0.0 <= now_s - self._last_s < _CALM_S:
            yield self._event, {"ended": True, "ticks": self._ticks, "elements": self._names(self._elements)}
            self._ticks, self._elements = 0, set()

    def _names(self, indices: tuple[int, ...] | set[int]) -> list[str]:
        return [self._command_format.elements[index].name for index in sorted(indices)]
