"""What every benchmark shares: rounds in which the contenders take turns, their figures, and what was aimed at.

A machine that does other work moves every absolute figure; what stays is the ratio of two contenders that were
measured seconds apart. So each figure is the median over rounds, and each ratio the median of the rounds' ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

Statistic = Callable[[Sequence[float]], float]
Rounds = Sequence[Sequence[float]]
Taken = TypeVar("Taken")


def p50(samples: Sequence[float]) -> float:
    """Return the median."""
    return float(np.percentile(samples, 50))


def p99(samples: Sequence[float]) -> float:
    """Return the 99th percentile."""
    return float(np.percentile(samples, 99))


def mean(samples: Sequence[float]) -> float:
    """Return the mean."""
    return float(np.mean(samples))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How thorough a run is.

    Attributes:
        quick: Whether to show only that everything works; its figures mean little.
        minutes: How long to run what is there to see whether something grows [min]; 0 leaves it out.
    """

    quick: bool = False
    minutes: float = 0.0

    def pick(self, full: float, quick: float) -> float:
        """Return the one or the other."""
        return quick if self.quick else full

    @property
    def rounds(self) -> int:
        """How often every contender takes its turn."""
        return 1 if self.quick else 5


@dataclass(frozen=True, kw_only=True)
class Target:
    """What a figure should be: ``<=`` or ``>=`` a limit, in the figure's unit; or, of a ratio, without a unit."""

    limit: float
    sense: Literal["<=", ">="] = "<="
    of: Literal["figure", "ratio"] = "figure"

    def is_met(self, figure: float, ratio: float | None) -> bool:
        """Whether it is reached."""
        value = figure if self.of == "figure" else ratio
        if value is None:
            return False
        return value <= self.limit if self.sense == "<=" else value >= self.limit


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of a table.

    Attributes:
        what: The quantity, with its conditions.
        unit: Unit of `ours` and `theirs`.
        ours: Median over the rounds.
        baseline: Name of what it is compared with; "" for none.
        theirs: The baseline's, likewise.
        ratio: ours / theirs, median of the rounds' ratios.
        target: What was aimed at, or None where the figure is only of interest.
    """

    what: str
    unit: str
    ours: float
    baseline: str = ""
    theirs: float | None = None
    ratio: float | None = None
    target: Target | None = None

    @property
    def verdict(self) -> str:
        """``met``, ``not met``, or "" without a target."""
        if self.target is None:
            return ""
        return "met" if self.target.is_met(self.ours, self.ratio) else "not met"


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """One file of this folder.

    Attributes:
        name: As on the command line.
        title: Heading of its table.
        method: What is measured and how, for the reader of the table.
        run: Measures.
        needs_assets: Whether it is left out without what `benchmarks.upstream` names.
    """

    name: str
    title: str
    method: str
    run: Callable[[Settings], list[Row]]
    needs_assets: bool = False


def alternate(contenders: Mapping[str, Callable[[], Taken]], rounds: int) -> dict[str, list[Taken]]:
    """Let the contenders take turns, every other round in reverse order; return what each one gave by round."""
    taken: dict[str, list[Taken]] = {name: [] for name in contenders}
    for number in range(rounds):
        order: Iterable[str] = contenders if number % 2 == 0 else reversed(list(contenders))
        for name in order:
            taken[name].append(contenders[name]())
    return taken


def compare(
    what: str, unit: str, ours: Rounds, theirs: Rounds | None = None, *, baseline: str = "", by: Statistic = p50,
    target: Target | None = None, scale: float = 1.0,
) -> Row:  # fmt: skip
    """Make a row of two contenders' samples.

    Args:
        what: The quantity.
        unit: Unit of the figures.
        ours, theirs: Samples by round, of equally many rounds.
        baseline: Name of the other contender.
        by: Makes one figure of a round.
        target: What was aimed at.
        scale: Factor from the samples' unit to `unit`.
    """
    mine = [by(samples) * scale for samples in ours]
    if theirs is None:
        return Row(what=what, unit=unit, ours=p50(mine), target=target)
    others = [by(samples) * scale for samples in theirs]
    ratios = [a / b for a, b in zip(mine, others, strict=True) if b]
    return Row(
        what=what, unit=unit, ours=p50(mine), baseline=baseline, theirs=p50(others),
        ratio=p50(ratios) if ratios else None, target=target,
    )  # fmt: skip
