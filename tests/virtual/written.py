"""All that is written on a bus in virtual time, in its order, with the instant at which the server did it."""

from __future__ import annotations

from typing import NamedTuple

from station.bus import keys
from station.life import events
from station.life.events import Event
from tests.virtual.network import Network


class Written(NamedTuple):
    """A write, at an instant of the virtual clock [s]."""

    at_s: float
    key: str
    value: bytes


class Log:
    """What is written on a network's server from now on; on a restarted one as well."""

    def __init__(self, network: Network) -> None:
        self._journal = network.server.journal
        self._begin = len(self._journal)

    @property
    def writes(self) -> list[Written]:
        new = self._journal[self._begin :]
        return [Written(at_ns * 1e-9, key.decode(), value) for at_ns, key, value in new if value is not None]

    def of(self, key: str) -> list[Written]:
        return [write for write in self.writes if write.key == key]

    def newest(self, key: str) -> bytes:
        return self.of(key)[-1].value

    def events(self) -> list[tuple[float, Event]]:
        found = [(write.at_s, events.decode(write.value)) for write in self.of(keys.EVENT)]
        return [(at_s, event) for at_s, event in found if event is not None]
