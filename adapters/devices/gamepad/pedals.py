"""Pedals, and pads that SDL does not know: which of their numbered controls stand for which of a gamepad's.

    left_stick_y: axis_1@-1 - axis_0@-1      the right pedal walks forwards, the left one backwards
    right_stick_x: -axis_2                   a rudder turns
    left_bumper: button_0

A term is a control by number, as SDL numbers them, with its sign. ``@-1`` or ``@1`` is where a pedal rests that has its
zero at one end of its way: it counts from 0 at rest to 1 at the other end. Several terms are added up.

Never tried on real pedals. Look first at where SDL says that they rest.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from adapters.devices.gamepad.names import CONTROLS
from station.errors import did_you_mean

_TERM = re.compile(r"\s*([+-]?)\s*((?:axis|button)_\d{1,3}|hat_\d{1,2}_[xy])(?:@(-?1))?\s*")


class Term(NamedTuple):
    """What a numbered control adds.

    Attributes:
        sign: 1, or -1.
        control: ``axis_1``, ``button_0``, ``hat_0_x``.
        rest: Where it rests: 0 in the middle, -1 or 1 at an end of its way.
    """

    sign: float
    control: str
    rest: float

    def value(self, shown: float) -> float:
        """Return what it adds when its control shows a value from -1 to 1."""
        return self.sign * (abs(shown - self.rest) / 2.0 if self.rest else shown)


def parsed(controls: Mapping[str, str]) -> dict[str, tuple[Term, ...]]:
    """Return the terms of each control of a gamepad.

    Raises:
        ValueError: no such control, or no terms; or two say that one pedal rests at different places.
    """
    found = {name: _terms(name, text) for name, text in controls.items()}
    rests(found)
    return found


def rests(controls: Mapping[str, Iterable[Term]]) -> dict[str, float]:
    """Return where numbered controls rest, by their names.

    Raises:
        ValueError: two terms say that one rests at different places.
    """
    found: dict[str, float] = {}
    for name, terms in controls.items():
        for term in terms:
            if found.setdefault(term.control, term.rest) != term.rest:
                raise ValueError(f"controls: {name}: {term.control} rests elsewhere in another of them")
    return found


def value(name: str, terms: Iterable[Term], shown: Mapping[str, float]) -> float:
    """Return what a control of a gamepad shows: a stick -1 to 1, all else 0 to 1."""
    total = sum(term.value(shown[term.control]) for term in terms)
    return min(max(total, -1.0 if "stick" in name and not name.endswith("_click") else 0.0), 1.0)


def _terms(name: str, text: str) -> tuple[Term, ...]:
    if name not in CONTROLS:
        raise ValueError(f"controls: no control {name!r}{did_you_mean(name, CONTROLS)}; expected one of a gamepad's")
    found, at = list[Term](), 0
    while at < len(text):
        match = _TERM.match(text, at)
        if match is None or (found and not match[1]):
            break
        found.append(Term(-1.0 if match[1] == "-" else 1.0, match[2], float(match[3] or 0)))
        at = match.end()
    if not found or at < len(text):
        raise ValueError(
            f"controls: {name} is {text!r}; expected terms such as axis_1, -axis_2, button_0, hat_0_x, or "
            "axis_1@-1 - axis_0@-1 for two pedals that rest at -1"
        )
    return tuple(found)
