"""Figures of a measurement, each with what is expected of it."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec


class Bounds(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is expected of a figure; None for no bound."""

    least: float | None = None
    most: float | None = None

    def __post_init__(self) -> None:
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(f"least is {self.least:g} and most is {self.most:g}; expected the smaller one first")

    def hold(self, least: float, most: float) -> bool:
        """Whether both ends of what was measured are within; what is no number is not."""
        above = self.least is None or least >= self.least
        below = self.most is None or most <= self.most
        return above and below and least == least and most == most  # noqa: PLR0124  # no number is unequal to itself

    def __str__(self) -> str:
        if self.least is not None and self.most is not None:
            return f"{self.least:g} to {self.most:g}"
        least = "" if self.least is None else f"at least {self.least:g}"
        return least if self.most is None else f"at most {self.most:g}"


class Figure(msgspec.Struct, frozen=True, kw_only=True):
    """Something that was measured.

    Attributes:
        name: What.
        text: How much, in words, with unit and place.
        expected: In words; "" where nothing is.
        is_good: Whether it is as expected.
        numbers: The same for programs, by name.
    """

    name: str
    text: str
    expected: str = ""
    is_good: bool = True
    numbers: dict[str, float | str] = {}


def number(name: str, value: float, unit: str, bounds: Bounds | None = None) -> Figure:
    """Return a figure that is one number."""
    bounds = bounds or Bounds()
    return Figure(
        name=name, text=f"{value:.4g} {unit}".rstrip(), expected=str(bounds), is_good=bounds.hold(value, value),
        numbers={"value": value},
    )  # fmt: skip


def table(figures: Sequence[Figure]) -> list[str]:
    """Return a line for each of some figures: its name, how much it is, and what is expected."""
    width = max(len(figure.name) for figure in figures)
    lines = []
    for figure in figures:
        verdict = f"{'' if figure.is_good else 'NOT '}as expected: {figure.expected}" if figure.expected else ""
        lines.append(f"  {figure.name:<{width}}  {figure.text}  {verdict}".rstrip())
    return lines
