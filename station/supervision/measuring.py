"""A measurement: what it keeps of each write of a stream while it lasts, and makes figures of in the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from typing import Protocol

import msgspec
import numpy as np

from station.bus import codec
from station.bus.client import Bus
from station.bus.codec import BadValue
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.contract import Contract, Element
from station.errors import NotReady, did_you_mean
from station.life.events import Event
from station.life.server import read_configurations
from station.protocols import Floats
from station.supervision import joint_response
from station.supervision.figures import Bounds, Figure, number
from station.supervision.measure import AFTER, LED, RATE, AfterCommands, Measure

_LOOK_S = 0.1
_SILENT_S = 0.5  # a stream that ends in so long a silence is slower than its writes were
_WORD = 1 << 16  # a smaller one is read as a number


def measured(
    measure: Measure, bus: Bus, robots: Sequence[str], meanwhile: Callable[[float], Sequence[Event]]
) -> list[Figure]:
    """Measure, and return the figures.

    Args:
        measure: What is measured.
        bus: The station's.
        robots: Suffixes of the keys of its robots.
        meanwhile: Called ten times a second with the time since the beginning [s]; returns what happened since the
            last call, and what it raises ends this.

    Raises:
        NotReady: nothing describes the stream, or it has no such numbers, or nothing came.
    """
    contracts = Contracts(read_configurations(bus))
    contract = _found(contracts, measure.stream, robots)
    followed = _found(contracts, measure.follows, robots) if measure.follows else None
    kept = _taker(measure, contract, followed)
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

        while (now_s := bus.clock.monotonic_s()) - began_s < measure.for_s:
            if now_s - looked_s >= _LOOK_S:
                looked_s = now_s
                look(now_s)
            sample = watch.wait(contract.key, after=newest, timeout_s=min(_LOOK_S, measure.for_s))
            if sample is None:
                continue
            newest = sample
            rows = _rows(contract, sample)
            rate.add(sample, len(rows), bus.clock.monotonic_s())
            beside = watch.latest(followed.key) if followed is not None else None
            targets = _rows(followed, beside) if followed is not None and beside is not None else None
            written_ns = sample.written_ns or sample.arrived_ns
            at_s = bus.clock.monotonic_s() if written_ns is None else written_ns * 1e-9
            kept.add(at_s - began_s, rows, targets)
        look(bus.clock.monotonic_s())
        if newest is None:
            raise NotReady(f"{contract.key}: nothing came in {measure.for_s:g} s; is its writer running?")
        return [rate.figure(measure, bus.clock.monotonic_s()), *kept.figures(happened)]


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


def _of_pattern(pattern: str, contract: Contract) -> list[int]:
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


class _Taker(Protocol):
    """Takes writes one after the other."""

    def add(self, at_s: float, rows: Floats, beside: Floats | None) -> None:
        """Take a write.

        Args:
            at_s: When it came, from the beginning [s].
            rows: What it holds, shape (k, m).
            beside: What the stream of targets holds then, shape (k, l); None where nothing is there.
        """
        ...

    def figures(self, happened: Sequence[tuple[str, float]]) -> list[Figure]:
        """Return what it came to; events by name, and when they were [s]."""
        ...


def _taker(measure: Measure, contract: Contract, followed: Contract | None) -> _Taker:
    """Return what a measurement needs.

    Raises:
        NotReady: a stream does not have the numbers.
    """
    if followed is not None:
        return _Following(measure, contract, followed)
    if measure.after_commands is not None:
        return _AfterCommands(measure, contract, measure.after_commands)
    return _Spreads(measure, contract)


class Spread:
    """Least, mean and greatest value of each of m numbers."""

    def __init__(self, count: int) -> None:
        self.least, self.most = np.full(count, np.inf), np.full(count, -np.inf)
        self._sum = np.zeros(count)
        self.rows = 0

    def add(self, rows: Floats) -> None:
        """Add rows, shape (k, m)."""
        if len(rows):
            self.least = np.minimum(self.least, rows.min(axis=0))
            self.most = np.maximum(self.most, rows.max(axis=0))
            self._sum += rows.sum(axis=0)
            self.rows += len(rows)

    def figure(self, name: str, which: Sequence[int], elements: Sequence[Element], bounds: Bounds) -> Figure:
        """Return the figure of some of the numbers, given by their places: the extremes, and whose they are."""
        chosen = np.asarray(which)
        low, high = chosen[np.argmin(self.least[chosen])], chosen[np.argmax(self.most[chosen])]
        least, most, mean = float(self.least[low]), float(self.most[high]), float(self._sum[chosen].mean() / self.rows)
        unit = f" {elements[low].unit}".rstrip()
        text = f"{_shown(least, unit)}{unit}"
        if least != most:
            ends = [
                _shown(end, unit) + f" ({elements[at].name})" * (len(which) > 1)
                for end, at in ((least, low), (most, high))
            ]
            text = f"{' to '.join(ends)}, mean {mean:.4g}{unit}"
        return Figure(
            name=name, text=text, expected=str(bounds), is_good=bounds.hold(least, most),
            numbers={"least": least, "least_at": elements[low].name, "mean": mean, "most": most,
                     "most_at": elements[high].name},
        )  # fmt: skip


def _shown(value: float, unit: str) -> str:
    """Return a number, or the bits of a large whole one that has no unit."""
    is_word = not unit and value >= _WORD and value.is_integer()
    return f"{int(value):#x}" if is_word else f"{value:.4g}"


class _Spreads:
    """Of the numbers that are named in `expect`."""

    def __init__(self, measure: Measure, contract: Contract) -> None:
        self._bounds = {name: bounds for name, bounds in measure.expect.items() if name != RATE}
        self._places = {name: _of_pattern(name, contract) for name in self._bounds}
        self._elements = contract.elements
        self._spread = Spread(len(contract.elements))

    def add(self, at_s: float, rows: Floats, beside: Floats | None) -> None:
        self._spread.add(rows)

    def figures(self, happened: Sequence[tuple[str, float]]) -> list[Figure]:
        return [
            self._spread.figure(name, places, self._elements, self._bounds[name])
            for name, places in self._places.items()
        ]


class _Following:
    """Of the numbers that both streams have."""

    def __init__(self, measure: Measure, contract: Contract, followed: Contract) -> None:
        self._bounds = measure.expect.get(LED)
        self._names = [name for name in followed.names if name in contract.names]
        if not self._names:
            raise NotReady(
                f"follows: {followed.key} and {contract.key} have no number of the same name; expected a stream of "
                "targets, and one of what became of them"
            )
        self._measured = [contract.names.index(name) for name in self._names]
        self._asked = [followed.names.index(name) for name in self._names]
        self._rows: list[tuple[float, Floats, Floats]] = []

    def add(self, at_s: float, rows: Floats, beside: Floats | None) -> None:
        if beside is not None:
            self._rows.append((at_s, beside[-1, self._asked], rows[-1, self._measured]))

    def figures(self, happened: Sequence[tuple[str, float]]) -> list[Figure]:
        if not self._rows:
            raise NotReady("follows: no target came; is the robot's server running?")
        time_s, asked, measured = (np.array(column) for column in zip(*self._rows, strict=True))
        found = joint_response.follows(time_s, asked, measured, [name.removesuffix("_pos") for name in self._names])
        return [*found, number(LED, float(len(found)), "", self._bounds)]


class _AfterCommands:
    """Of torques and speeds."""

    def __init__(self, measure: Measure, contract: Contract, what: AfterCommands) -> None:
        self._bounds, self._since = measure.expect.get(AFTER), what.since
        self._torque, self._speed = _of_pattern(what.torque, contract), _of_pattern(what.speed, contract)
        if len(self._torque) != len(self._speed):
            raise NotReady(
                f"after_commands: {len(self._torque)} numbers are called {what.torque} and {len(self._speed)} "
                f"{what.speed}; expected the torque and the speed of the same joints"
            )
        self._bits = _of_pattern(what.bits, contract) if what.bits else []
        self._names = contract.names
        self._rows: list[tuple[Floats, Floats]] = []

    def add(self, at_s: float, rows: Floats, beside: Floats | None) -> None:
        self._rows.append((np.full(len(rows), at_s), rows[:, [*self._torque, *self._speed, *self._bits]]))

    def figures(self, happened: Sequence[tuple[str, float]]) -> list[Figure]:
        time_s, rows = (np.concatenate(column) for column in zip(*self._rows, strict=True))
        count = len(self._torque)
        torque, speed, words = rows[:, :count], rows[:, count : 2 * count], rows[:, 2 * count :]
        since, ceased_s = next((event for event in happened if event[0] == self._since), ("this began", 0.0))
        since_s = time_s - ceased_s
        found = joint_response.let_go(since_s, torque, speed, self._bounds, since=since)
        if self._bits:
            found.append(joint_response.bits(since_s, words, [self._names[place] for place in self._bits]))
        return found
