"""What is a good command: in time, parsed, of the right length, finite, within range; the rest is refused and counted.

A line that was frozen or cut delivers the commands of seconds ago in one burst, and each arrives now. So a command has
two ages: since it arrived, and, where its stamp is of this machine's clock, since it was written.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from station.bus import codec
from station.protocols import CommandFormat, Floats

RefusalKind = Literal["not-json", "wrong-length", "not-finite", "out-of-range", "second-writer", "stale", "wrong-clock"]

_LONGEST_BYTES = 16384  # 35 numbers take 1 kB; parsing a megabyte would cost the loop its deadline
_SLACK_S = 0.02  # a clock that was read before a command came makes it seem to come from the future


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a command is not applied."""

    kind: RefusalKind
    text: str


@dataclass(frozen=True, slots=True)
class Checked:
    """A command that may be applied.

    Attributes:
        vector: Its numbers within their ranges, shape (m,).
        clamped: Indices of those that had to be moved to the end of their range.
    """

    vector: Floats
    clamped: tuple[int, ...]


def check_command(data: bytes, command_format: CommandFormat) -> Checked | Refusal:
    """Read a command as it stands on the bus and judge it."""
    if len(data) > _LONGEST_BYTES:
        expected = len(command_format.default)
        return Refusal("wrong-length", f"{len(data)} bytes, expected a JSON list of {expected} numbers")
    try:
        numbers = codec.parse_json_numbers(data)
    except codec.BadValue as error:  # Python writes NaN and Infinity, which JSON does not know
        return Refusal("not-finite" if isinstance(error, codec.BadNumber) else "not-json", str(error))
    if (refusal := why_refused(numbers, command_format)) is not None:
        return refusal
    vector = np.array(numbers)
    clamped = np.clip(vector, command_format.lower, command_format.upper)
    return Checked(clamped, tuple(np.flatnonzero(clamped != vector).tolist()))


def why_refused(numbers: Sequence[float], command_format: CommandFormat) -> Refusal | None:
    """Return why numbers are no command, or None.

    Of numbers and not of an array: of a few at a time NumPy takes ten times as long, where its code left the caches.
    """
    if len(numbers) != len(command_format.default):
        return Refusal("wrong-length", f"{len(numbers)} values, expected {len(command_format.default)}")
    if not all(map(math.isfinite, numbers)):
        index = next(index for index, number in enumerate(numbers) if not math.isfinite(number))
        return Refusal("not-finite", f"{command_format.elements[index].name} is not finite")
    ranges = (each.tolist() for each in (command_format.lower, command_format.upper, command_format.margin))
    for index, (number, lower, upper, margin) in enumerate(zip(numbers, *ranges, strict=True)):
        if number < lower - margin or number > upper + margin:
            return Refusal("out-of-range", _describe(number, index, command_format))
    return None


@dataclass(frozen=True, slots=True, eq=False)
class CommandSample:
    """A command as it was found, good or bad; each write is a new object.

    Attributes:
        value: Its bytes.
        arrived_s: When it reached us, on the gate's clock [s]; None when it was there before we looked.
        delay_s: How long before that it was written, by its writer's own clock [s]; None where that is unknown: without
            a stamp, from another machine, in lock-step.
        written_ns, arrived_ns: When it was written and when it arrived, on this machine's monotonic clock; 0 when
            unknown, as `written_ns` for a foreign writer.
        seq: Sequence number of its write; 0 for a foreign writer.
        source: Its writer, as in its stamp; "" where that does not matter.
    """

    value: bytes
    arrived_s: float | None
    delay_s: float | None = None
    written_ns: int = 0
    arrived_ns: int = 0
    seq: int = 0
    source: str = ""


Samples = CommandSample | None | tuple[CommandSample | None, ...]
"""The newest write of a robot's command, or of the command of each of its parts."""


@dataclass
class CommandValidator:
    """Remembers the newest good command and counts what was refused.

    Attributes:
        command_format: The command's format.
        longest_delay_s: A command that took longer to come is refused [s].
        sample: The newest sample, good or bad.
        good: The sample that `vector` was read from.
        vector: The newest good command, shape (m,), or None.
        refusal: Why the newest sample was refused, or None when it was good.
        refused: Refused samples by kind.
        clamped: Indices of the elements that were clamped in the newest good command.
        clamped_samples: Samples with a clamped element since the start.
    """

    command_format: CommandFormat
    longest_delay_s: float = math.inf
    sample: CommandSample | None = None
    good: CommandSample | None = None
    vector: Floats | None = None
    refusal: Refusal | None = None
    refused: Counter[str] = field(default_factory=Counter)
    clamped: tuple[int, ...] = ()
    clamped_samples: int = 0
    _asked_s: float | None = None  # when the age of `good` was last asked for
    _least_s: float = 0.0  # how old it must be by the time that has passed here
    _found_s: float | None = None  # when `sample` was first asked for, where it is not known when it came

    def update(self, sample: CommandSample | None) -> bool:
        """Set the newest sample; return whether it is one that was not seen before."""
        if sample is None or sample is self.sample:
            return False
        self.sample, self._found_s = sample, None
        checked = self._why_not_in_time(sample) or check_command(sample.value, self.command_format)
        if isinstance(checked, Refusal):
            self.refusal = checked
            self.refused[checked.kind] += 1
            return True
        self.refusal, self.good, self.vector = None, sample, checked.vector
        self.clamped = checked.clamped
        self.clamped_samples += bool(checked.clamped)
        self._asked_s, self._least_s = None, 0.0
        return True

    @property
    def delay_s(self) -> float:
        """How long the newest good command took to come [s]; 0.0 where that is unknown."""
        return (self.good.delay_s or 0.0) if self.good is not None else 0.0

    def forget(self) -> None:
        """Let no earlier command be followed any more; the counters stay."""
        self.good = self.vector = None

    def is_refusing(self, now_s: float, within_s: float) -> bool:
        """Whether the newest sample was refused and came within a time [s]."""
        if self.refusal is None or self.sample is None or self.sample.arrived_s is None:
            return False
        return now_s - self.sample.arrived_s <= within_s

    def quiet_s(self, now_s: float) -> float:
        """Return for how long no command has come, good or bad [s]; infinite when none has.

        One that was found without anybody knowing when it came, as after a cut, may have come in this very moment.
        """
        if self.sample is None:
            return math.inf
        if self.sample.arrived_s is not None:
            return now_s - self.sample.arrived_s
        if self._found_s is None and math.isfinite(now_s):
            self._found_s = now_s
        return 0.0 if self._found_s is None else now_s - self._found_s

    def age_s(self, now_s: float) -> float:
        """Return the age of the newest good command [s]; infinite when there is none or it is unknown.

        It never grows by less than the time between the calls: a clock that jumps back makes no command young again.
        """
        if self.good is None or self.good.arrived_s is None or not math.isfinite(self.good.arrived_s):
            return math.inf
        if math.isfinite(now_s):
            self._least_s += max(0.0, now_s - self._asked_s) if self._asked_s is not None else 0.0
            self._asked_s = now_s
        age_s = now_s - self.good.arrived_s
        return age_s if age_s >= self._least_s - _SLACK_S else self._least_s

    def _why_not_in_time(self, sample: CommandSample) -> Refusal | None:
        delay_s, longest_s = sample.delay_s, self.longest_delay_s
        if delay_s is None or -_SLACK_S <= delay_s <= longest_s:
            return None
        if delay_s > longest_s:
            return Refusal("stale", f"written {delay_s:.3g} s before it came, allowed are {longest_s:g} s")
        return Refusal("wrong-clock", f"stamped {-delay_s:.3g} s after it came: not by this machine's monotonic clock")


def _describe(number: float, index: int, command_format: CommandFormat) -> str:
    low, high = (
        command_format.lower[index] - command_format.margin[index],
        command_format.upper[index] + command_format.margin[index],
    )
    return f"{command_format.elements[index].name} is {number:.4g}, allowed {low:.4g} to {high:.4g}"
