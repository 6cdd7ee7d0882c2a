"""Names and units of the numbers of a vector."""

from __future__ import annotations

import msgspec


class Element(msgspec.Struct, frozen=True):
    """One number of a vector: a name that is a valid field name anywhere, and its unit ("" for none)."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """What a person reads of it: ``left_knee_pos [rad]``, or its name alone where it has no unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def elements(*groups: tuple[tuple[str, ...], str]) -> tuple[Element, ...]:
    """Build elements from groups of names that share a unit."""
    return tuple(Element(name, unit) for names, unit in groups for name in names)


def names_of(items: tuple[Element, ...]) -> tuple[str, ...]:
    """Return the names of elements, in order."""
    return tuple(item.name for item in items)


def positions(names: tuple[str, ...]) -> tuple[str, ...]:
    """Element names of joint positions."""
    return tuple(f"{name}_pos" for name in names)


def velocities(names: tuple[str, ...]) -> tuple[str, ...]:
    """Element names of joint velocities."""
    return tuple(f"{name}_vel" for name in names)
