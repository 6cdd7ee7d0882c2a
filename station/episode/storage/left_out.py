"""Keys that an episode does without, by wish: what can be derived from the rest need not be stored."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from station.bus import keys

if TYPE_CHECKING:
    from station.bus.tap import Write


def why_not(names: Iterable[str]) -> str:
    """Return in a line why some names cannot be left out; "" where they can."""
    for name in names:
        if not name or keys.is_bookkeeping(name):
            return (
                f"leave_out names {name!r}; expected keys of a robot or device, whole or up to a _, such as "
                "policy_obs: what the station says of itself is always recorded"
            )
    return ""


class LeftOut:
    """Tells what is left out.

    Args:
        names: Keys, or beginnings of keys up to a ``_``: ``policy_obs`` is that of every robot.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._names = frozenset(names)
        self._beginnings = tuple(f"{name}_" for name in self._names)

    def without(self, writes: Sequence[Write]) -> Sequence[Write]:
        """Return writes without those of the keys that are left out."""
        if not self._names:
            return writes
        return [
            write for write in writes if write.key not in self._names and not write.key.startswith(self._beginnings)
        ]
