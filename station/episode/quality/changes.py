"""Changes of keys that are no values in the file: writes that the tap could not know, and deletions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from station.bus import keys
from station.bus.tap import not_mirrored
from station.contract import Contract
from station.episode.quality.finding_parts import KeyChanges
from station.episode.reading.messages import Message

DELETED = "deleted"
"""Stands for the command of a deletion, which may have been any: DEL, an expiry, FLUSHALL."""

_MOST = 1000  # kinds; a client may invent keys


@dataclass
class ChangeCounter:
    """Takes the messages of an episode and counts such changes by command and key.

    Attributes:
        start_ns: Instant that times are told from [ns since the epoch].
        contract: Tells what a key holds.
    """

    start_ns: int
    contract: Callable[[str], Contract | None]
    _found: dict[tuple[str, str], KeyChanges] = field(default_factory=dict)

    def feed(self, message: Message) -> None:
        """Take a message; any other is passed over."""
        if message.topic == keys.NOT_MIRRORED:
            said = not_mirrored.decode(message.data)
            if said is not None:
                self._count(said.command, said.key, said.count, message.log_ns)
        elif message.channel.is_deletion:
            self._count(DELETED, message.topic, 1, message.log_ns)

    def not_mirrored(self) -> list[KeyChanges]:
        """Return the writes that are not in the file, in the order of the first of each kind."""
        return [found for found in self._found.values() if found.command != DELETED]

    def deletions(self) -> list[KeyChanges]:
        """Return the deletions, likewise."""
        return [found for found in self._found.values() if found.command == DELETED]

    def _count(self, command: str, key: str, count: int, log_ns: int) -> None:
        known = self._found.get((command, key))
        if known is not None:
            self._found[command, key] = msgspec.structs.replace(known, count=known.count + count)
        elif len(self._found) < _MOST:
            known_as = self.contract(key.removesuffix("@"))
            at_s = round((log_ns - self.start_ns) * 1e-9, 3)
            self._found[command, key] = KeyChanges(
                command=command, key=key, count=count, at_s=at_s, role=known_as.role if known_as is not None else None
            )
