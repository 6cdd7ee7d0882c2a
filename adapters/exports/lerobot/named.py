"""Columns of numbers that stand for names: each episode numbers its own, and the data set numbers all of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.exports.lerobot.plan import COMMANDER, GATE, SUBTASK, Plan
from station.episode.reading.messages import Ints
from station.export.kind import Shard
from station.export.tracks import Words
from station.export.words import GATE_STATES

NONE = "not recorded"
"""What a number below 0 stands for."""

FACTS = {COMMANDER: "commanders", SUBTASK: "subtasks"}
"""For each column that is numbered anew in the data set, the fact of a shard that counts its rows by name."""


def gate_numbers(words: Words | None, codes: Ints | None, rows: int) -> Ints:
    """Return the gate's state in each row as an index of `GATE_STATES`, -1 where none was recorded."""
    names, found = _named(words, codes, rows)
    numbers = [GATE_STATES.index(name) if name in GATE_STATES else -1 for name in names]
    return np.array(numbers, dtype=np.int64)[found]


def counted(words: Words | None, codes: Ints | None, rows: int) -> tuple[Ints, dict[str, int]]:
    """Return for each row the number of its name, "" for none, and how many rows have each name, by number."""
    names, found = _named(words, codes, rows)
    used, numbers, counts = np.unique(found, return_inverse=True, return_counts=True)
    return numbers.astype(np.int64), {names[name]: int(count) for name, count in zip(used, counts, strict=True)}


def _named(words: Words | None, codes: Ints | None, rows: int) -> tuple[list[str], Ints]:
    """Return names, each once, and the number of each row's."""
    if words is None or codes is None:
        return [""], np.zeros(rows, dtype=np.int64)
    names = list(dict.fromkeys((*words.names, "")))
    numbers = np.array([names.index(name) for name in (*words.names, "")], dtype=np.int64)  # the last one is -1's
    return names, numbers[codes]


class Names:
    """The names of a column in all episodes, numbered as they come.

    Args:
        shards: The episodes.
        fact: Which fact of them counts rows by name.
        is_none_numbered: Whether rows without a name have a number like any other; else it is -1.
    """

    def __init__(self, shards: Iterable[Shard], fact: str, *, is_none_numbered: bool) -> None:
        self._fact = fact
        found = dict.fromkeys(name for shard in shards for name in shard.made.facts[fact])
        self.names = [name for name in found if name or is_none_numbered]
        self._numbers = {"": -1} | {name: number for number, name in enumerate(self.names)}

    def renumbered(self, shard: Shard, rows: NDArray[Any]) -> Ints:
        """Return the numbers in the data set of what an episode numbered itself, shape (n,)."""
        numbers: Ints = self._of(shard)[rows]
        return numbers

    def every(self, shard: Shard) -> Ints:
        """Return the numbers of all rows of an episode, in no order."""
        return np.repeat(self._of(shard), list(shard.made.facts[self._fact].values()))

    def _of(self, shard: Shard) -> Ints:
        return np.array([self._numbers[name] for name in shard.made.facts[self._fact]], dtype=np.int64)


def names_of(shards: Sequence[Shard], plan: Plan) -> dict[str, Names]:
    """Return the names of each column that is numbered anew."""
    wanted = [COMMANDER, *([SUBTASK] if plan.subtasks == "marks" else [])]
    # LeRobot takes the number of a subtask for a place in its table, where -1 would be the last one.
    return {column: Names(shards, FACTS[column], is_none_numbered=column == SUBTASK) for column in wanted}


def document(names: Mapping[str, Names]) -> dict[str, dict[str, str]]:
    """Return what each number stands for, by column."""
    listed = {GATE: GATE_STATES, COMMANDER: names[COMMANDER].names}
    return {
        column: {"-1": NONE, **{str(number): name for number, name in enumerate(those)}}
        for column, those in listed.items()
    }
