"""What the sensors of a glove are called.

A finger is one of `FINGERS`. A sensor bears its name alone where it measures the whole finger, or with ``_0``, ``_1``,
``_2`` for the joints from the knuckle to the tip: ``index_0``. ``thumb_rotation`` turns the thumb across the palm.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

FINGERS = ("thumb", "index", "middle", "ring", "little")
UNUSED = "-"
"""In place of a name: a number of the line that is no sensor."""

PRESETS: dict[int, tuple[str, ...]] = {
    5: FINGERS,
    15: tuple(f"{finger}_{joint}" for finger in FINGERS for joint in range(3)),
}
"""The usual names of sensors, by how many numbers a line has."""

_NAME = re.compile(rf"({'|'.join(FINGERS)})(_[012])?|thumb_rotation")


def why_not(names: Sequence[str]) -> str:
    """Return in one line what is wrong with the names of sensors, without those that are not used; "" for nothing."""
    if not names:
        return "no sensor is named; expected at least one"
    for name in names:
        if not _NAME.fullmatch(name):
            return (
                f"{name!r} is no sensor; expected one of {', '.join(FINGERS)}, alone or with _0, _1, _2 from the "
                "knuckle to the tip, or thumb_rotation"
            )
        if names.count(name) > 1:
            return f"sensor {name} comes twice"
    return ""
