"""What a measurement keeps of each write while it lasts, and makes figures of in the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from station.contract import Contract, Element
from station.errors import NotReady
from station.protocols import Floats
from station.supervision import joint_response
from station.supervision.figures import Bounds, Figure, number
from station.supervision.measure import AFTER, LED, RATE, AfterCommands, Measure, of_pattern

_WORD = 1 << 16  # a smaller one is read as a number


class Taker(Protocol):
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


def taker(measure: Measure, contract: Contract, followed: Contract | None) -> Taker:
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
        self._places = {name: of_pattern(name, contract) for name in self._bounds}
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
        self._torque, self._speed = of_pattern(what.torque, contract), of_pattern(what.speed, contract)
        if len(self._torque) != len(self._speed):
            raise NotReady(
                f"after_commands: {len(self._torque)} numbers are called {what.torque} and {len(self._speed)} "
                f"{what.speed}; expected the torque and the speed of the same joints"
            )
        self._bits = of_pattern(what.bits, contract) if what.bits else []
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
