"""The step `measure` of a runbook: what a stream of the bus says for a while, and whether that is as expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Literal

import msgspec

from station.bus import codec
from station.bus.client import Bus
from station.bus.codec import BadValue
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.contract import Contract
from station.errors import NotReady, did_you_mean
from station.life.events import Event
from station.life.server import read_configurations
from station.supervision.figures import Bounds, Figure, number

if TYPE_CHECKING:  # it loads NumPy
    from station.protocols import Floats

_LOOK_S = 0.1
_SILENT_S = 0.5  # a stream that ends in so long a silence is slower than its writes were
RATE = "rate"
"""In `expect`: rows that a stream has in a second."""

LED, AFTER = "led", "after"
"""In `expect`: how many joints were led, with `follows`; after how long motors let go [s], with `after_commands`."""


class AfterCommands(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What tells how motors are when nobody commands them, by names in which ``*`` stands for anything.

    Attributes:
        torque: Torques [N m].
        speed: Speeds of the same joints, in the same order [rad/s].
        bits: Words whose bits tell an error; "" for none.
        since: Event from which on there are no commands, where one comes; else that is so from the beginning.
    """

    torque: str
    speed: str
    bits: str = ""
    since: str = ""


class Measure(msgspec.Struct, frozen=True, kw_only=True):
    """What is measured, and what is expected of it.

    Attributes:
        measure: What it is for, in a sentence.
        stream: A key, or what it is without the name of its robot: ``state_samples``.
        for_s: For how long [s].
        expect: Bounds by the name of a number of the stream, in which ``*`` stands for anything; ``rate`` is how many
            rows it has in a second [Hz]; ``led`` and ``after`` as below.
        follows: A stream of targets, whose numbers are called as those of `stream` are: each joint that is led has to
            follow, and alone; ``led`` is how many were.
        after_commands: Tells whether motors hold, damp or are limp once they get no commands; ``after`` is when.
        if_not: What becomes of the runbook where something is not as expected.
    """

    measure: str
    stream: str
    for_s: float
    expect: dict[str, Bounds] = {}
    follows: str = ""
    after_commands: AfterCommands | None = None
    if_not: Literal["stop", "continue"] = "stop"

    def __post_init__(self) -> None:
        if not self.for_s > 0.0:
            raise ValueError(f"for is {self.for_s:g} s; expected more than 0")
        if self.follows and self.after_commands is not None:
            raise ValueError("follows and after_commands: expected one of them; give the other a step of its own")
        other = LED if self.follows else AFTER if self.after_commands is not None else ""
        for name in self.expect:
            if other and name not in (RATE, other):
                raise ValueError(
                    f"expect: {name!r} is no figure here{did_you_mean(name, (RATE, other))}; known: {RATE}, {other}"
                )

    def __str__(self) -> str:
        return f"measure: {self.measure}"

    def run(self, bus: Bus, robots: Sequence[str], meanwhile: Callable[[float], Sequence[Event]]) -> list[Figure]:
        """Measure, and return the figures.

        Args:
            bus: The station's.
            robots: Suffixes of the keys of its robots.
            meanwhile: Called ten times a second with the time since the beginning [s]; returns what happened since the
                last call, and what it raises ends this.

        Raises:
            NotReady: nothing describes the stream, or it has no such numbers, or nothing came.
        """
        from station.supervision import measuring

        contracts = Contracts(read_configurations(bus))
        contract = _found(contracts, self.stream, robots)
        followed = _found(contracts, self.follows, robots) if self.follows else None
        taker = measuring.taker(self, contract, followed)
        rate = _RowRate()
        wanted = [contract.key, *([followed.key] if followed is not None else [])]
        happened: list[tuple[str, float]] = []
        with bus.watch(wanted) as watch:
            newest: Sample | None = None
            began_s, began_ns = bus.clock.monotonic_s(), bus.clock.wall_ns()
            looked_s = began_s

            def look(now_s: float) -> None:
                events = meanwhile(now_s - began_s)
                happened.extend((event.name, (event.wall_ns - began_ns) * 1e-9) for event in events)

            while (now_s := bus.clock.monotonic_s()) - began_s < self.for_s:
                if now_s - looked_s >= _LOOK_S:
                    looked_s = now_s
                    look(now_s)
                sample = watch.wait(contract.key, after=newest, timeout_s=min(_LOOK_S, self.for_s))
                if sample is None:
                    continue
                newest = sample
                rows = _rows(contract, sample)
                rate.add(sample, len(rows), bus.clock.monotonic_s())
                beside = watch.latest(followed.key) if followed is not None else None
                targets = _rows(followed, beside) if followed is not None and beside is not None else None
                written_ns = sample.written_ns or sample.arrived_ns
                at_s = bus.clock.monotonic_s() if written_ns is None else written_ns * 1e-9
                taker.add(at_s - began_s, rows, targets)
            look(bus.clock.monotonic_s())
            if newest is None:
                raise NotReady(f"{contract.key}: nothing came in {self.for_s:g} s; is its writer running?")
            return [rate.figure(self, bus.clock.monotonic_s()), *taker.figures(happened)]


class _RowRate:
    """How many rows a stream has in a second, by the clock of its writer, from writes that follow on each other.

    A write that this process was too late to see is left out on both sides of the fraction.
    """

    def __init__(self) -> None:
        self._rows, self._seconds, self._missed = 0, 0.0, 0
        self._before: Sample | None = None
        self._came_s = 0.0

    def add(self, sample: Sample, rows: int, now_s: float) -> None:
        before, self._before, self._came_s = self._before, sample, now_s
        if before is None:
            return
        if sample.stamp is None or before.stamp is None or sample.stamp.source != before.stamp.source:
            assert sample.arrived_ns is not None
            self._rows += rows
            self._seconds += (sample.arrived_ns - (before.arrived_ns or sample.arrived_ns)) * 1e-9
        elif sample.stamp.seq == before.stamp.seq + 1:
            self._rows += rows
            self._seconds += (sample.stamp.mono_ns - before.stamp.mono_ns) * 1e-9
        else:
            self._missed += max(0, sample.stamp.seq - before.stamp.seq - 1)

    def figure(self, measure: Measure, now_s: float) -> Figure:
        silent_s = now_s - self._came_s
        seconds = self._seconds + (silent_s if silent_s > _SILENT_S else 0.0)
        found = number(RATE, self._rows / seconds if seconds else 0.0, "Hz", measure.expect.get(RATE))
        return msgspec.structs.replace(found, numbers=found.numbers | {"writes_not_seen": self._missed})


def _found(contracts: Contracts, stream: str, robots: Sequence[str]) -> Contract:
    """Return what a stream holds.

    Raises:
        NotReady: nothing describes it, or it holds no numbers with names.
    """
    for key in (stream, *(f"{stream}_{robot}" for robot in robots)):
        contract = contracts.get(key)
        if contract is None:
            continue
        if not contract.elements:
            raise NotReady(f"stream {key}: it holds {contract.codec}; expected one of numbers with names")
        return contract
    known = [item.key.removesuffix(f"_{robot}") for robot in robots for item in contracts.of(robot) if item.elements]
    raise NotReady(
        f"stream {stream!r}: nothing describes it{did_you_mean(stream, known)}; known of "
        f"{', '.join(robots) or 'no robot'}: {', '.join(dict.fromkeys(known)) or 'none'}"
    )


def of_pattern(pattern: str, contract: Contract) -> list[int]:
    """Return the places of the numbers of a stream whose names fit a pattern.

    Raises:
        NotReady: there is none.
    """
    found = [place for place, name in enumerate(contract.names) if fnmatchcase(name, pattern)]
    if not found:
        first = ", ".join(contract.names[:6])
        raise NotReady(
            f"stream {contract.key}: it has no number {pattern!r}{did_you_mean(pattern, contract.names)}; it has "
            f"{len(contract.names)}: {first}, …; `station describe {contract.key}` lists them"
        )
    return found


def _rows(contract: Contract, sample: Sample) -> Floats:
    """Return what was written as rows, shape (k, m)."""
    count = len(contract.elements)
    try:
        kind = contract.vector_codec
        values = codec.parse_f64(sample.value) if kind is None else codec.parse_vector(kind, sample.value)
        if len(values) % count or (kind is not None and len(values) != count):
            raise BadValue(f"{len(values)} numbers for {count} names")
    except BadValue as error:
        raise NotReady(f"stream {contract.key}: what came does not fit what its server says of it: {error}") from None
    return values.reshape(-1, count)
