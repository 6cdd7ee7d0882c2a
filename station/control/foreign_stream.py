"""Which message of a stream of other programs is passed on to the bus, and why another is not.

Such streams say neither who sends nor when: a message is as old as it lay in this computer, one sender is heard at a
time, and what is refused is counted by its reason and told when that begins and ends. What a message means says the
function that is given. Pure: no socket, no bus, no clock.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from station.bus import codec
from station.contract import Contract
from station.control.command_arbiter import CommandArbiter
from station.control.command_validator import why_refused
from station.life.events import Severity
from station.protocols import CommandFormat

SILENT_S = 0.5
"""Whoever has sent nothing for so long on a stream is silent, and another may command on it [s]."""

LATE_S = 0.1
"""A message that lay in this computer for longer is refused [s]: it came while this process stood still."""


class Arrived(NamedTuple):
    """A message.

    Attributes:
        message: Its bytes.
        sender: Who sent it.
        arrived_s: When it came, on the monotonic clock [s].
    """

    message: bytes
    sender: str
    arrived_s: float


@dataclass(frozen=True, slots=True)
class Taken:
    """A message that may be passed on.

    Attributes:
        values: Bytes of each key.
        arrived_s: When it came, on the monotonic clock [s].
        sender: Who sent it.
    """

    values: dict[str, bytes]
    arrived_s: float
    sender: str


class Dropped(NamedTuple):
    """Why a message is not passed on: a word, and a sentence."""

    kind: str
    text: str


Translate = Callable[[bytes, float], dict[str, bytes] | Dropped]
"""From a message, and when it came [s], to the bytes of each key."""


def as_command(numbers: Sequence[float], command_format: CommandFormat) -> dict[str, bytes] | Dropped:
    """Return numbers as a command stands on the bus, by its key, or why a robot would not take them."""
    refusal = why_refused(numbers, command_format)
    if refusal is not None:
        return Dropped(refusal.kind, refusal.text)
    return {command_format.key: codec.json_vector(numbers)}


def why_not_as_described(value: bytes, contract: Contract) -> Dropped | None:
    """Return why a value is not what the contract of its key says, or None: numbers, as many, all finite; JSON."""
    kind = contract.vector_codec
    try:
        if kind is not None:
            vector = codec.parse_vector(kind, value)
            if contract.elements and len(vector) != len(contract.elements):
                expected = len(contract.elements)
                return Dropped("wrong-length", f"{len(vector)} numbers, expected {expected} of {contract.key}")
            if not all(map(math.isfinite, vector.tolist())):
                return Dropped("not-finite", f"a number of {contract.key} is not finite")
        elif contract.codec == "json":
            codec.parse_json(value)
    except codec.BadValue as error:
        return Dropped("not-finite" if isinstance(error, codec.BadNumber) else "bad-value", f"{contract.key}: {error}")
    return None


class ForeignStream:
    """Decides of each message of one stream.

    Args:
        word: What events of it begin with, and by which name they say which stream it is: ``lcm``, ``channel``.
        name: Of the stream.
        translate: What a message is on the bus.
        then: What becomes of what it commands once it is silent, for that event.

    Attributes:
        passed: Messages that were passed on.
        dropped: Others, by the reason.
    """

    def __init__(self, word: tuple[str, str], name: str, translate: Translate, *, then: str) -> None:
        self.name, self._translate, self._then = name, translate, then
        self._word, self._called = word
        self.passed, self.dropped = 0, Counter[str]()
        self._senders = CommandArbiter("keep-first", SILENT_S)
        self._taken: Taken | None = None
        self._delay_s = 0.0
        self._is_live = False
        self._refused_s: float | None = None  # when a message was refused last; None once that is over
        self._events: list[tuple[str, Severity, dict[str, Any]]] = []

    @property
    def is_live(self) -> bool:
        """Whether messages of it are being passed on."""
        return self._is_live

    def take(self, arrived: Arrived, now_s: float) -> Taken | None:
        """Return what is to be written for a message, or None.

        Args:
            arrived: The message.
            now_s: The instant [s].
        """
        found = self._values(arrived, now_s)
        if isinstance(found, Dropped):
            self.dropped[found.kind] += 1
            if self._refused_s is None:
                reason = f"{found.kind}: {found.text}"
                self._tell("refused", "warning", reason=reason, sender=arrived.sender)
            self._refused_s = now_s
            return None
        if not self._senders.on_write(arrived.sender, arrived.arrived_s):
            self.dropped["second-sender"] += 1
            return None
        return Taken(found, arrived.arrived_s, arrived.sender)

    def record(self, taken: Taken, now_s: float) -> None:
        """Record that a message has been passed on, at an instant [s]."""
        self.passed, self._delay_s = self.passed + 1, now_s - taken.arrived_s
        if not self._is_live:
            self._is_live = True
            back = {} if self._taken is None else {"silent_s": round(taken.arrived_s - self._taken.arrived_s, 3)}
            self._tell("live" if self._taken is None else "back", "info", sender=taken.sender, **back)
        self._taken = taken

    def on_tick(self, now_s: float) -> Iterator[tuple[str, Severity, dict[str, Any]]]:
        """Yield the events since the last call: name, severity, detail.

        Args:
            now_s: The instant until which every message was taken [s].
        """
        self._senders.know((-math.inf, now_s))
        if self._is_live and self._taken is not None and now_s - self._taken.arrived_s > SILENT_S:
            self._is_live = False
            self._tell("silent", "warning", sender=self._taken.sender, passed=self.passed, then=self._then)
        if self._refused_s is not None and now_s - self._refused_s > SILENT_S:
            self._refused_s = None
            self._tell("refused", "info", ended=True, dropped=dict(self.dropped))
        for news in self._senders.pop_news(now_s):
            severity: Severity = "warning" if news.kind == "rivals" else "info"
            name = "handover" if news.kind == "handover" else "second-sender"
            ended = {"ended": True} if news.kind == "alone" else {}
            self._tell(name, severity, senders=list(news.writers), heard=news.obeyed, refused=news.refused, **ended)
        events, self._events = self._events, []
        yield from events

    def status(self, now_s: float) -> dict[str, Any]:
        """Return what a heartbeat tells of the stream at an instant [s]; `delay_ms` is from arrival to the bus."""
        told: dict[str, Any] = {"passed": self.passed, "dropped": dict(self.dropped), "live": self._is_live}
        if self._taken is not None:
            age_s = now_s - self._taken.arrived_s
            told |= {"sender": self._taken.sender, "age_s": round(age_s, 3), "delay_ms": round(self._delay_s * 1e3, 2)}
        return told

    def _values(self, arrived: Arrived, now_s: float) -> dict[str, bytes] | Dropped:
        if (age_s := now_s - arrived.arrived_s) > LATE_S:
            return Dropped("stale", f"it lay here for {age_s:.3g} s, allowed are {LATE_S:g} s")
        return self._translate(arrived.message, arrived.arrived_s)

    def _tell(self, name: str, severity: Severity, **detail: Any) -> None:
        self._events.append((f"{self._word}-{name}", severity, {self._called: self.name, **detail}))
