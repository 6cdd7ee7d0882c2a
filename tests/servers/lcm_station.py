"""The LCM bridge as a process of its own on a real bus, and whoever speaks LCM beside it, over real UDP."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from adapters.lcm.homie import CHANNELS
from adapters.lcm.multicast import Multicast
from station.bus.address import BusAddress
from tests.adapters.lcm.test_multicast import free_port
from tests.servers.bridge_station import BridgeStation

KINDS = {each.name: each for each in CHANNELS}
SOME_ARMS = [0.3, 0.2, 0.1, 0.5, 0.0, 0.1, 0.0, 0.3, -0.2, -0.1, 0.5, 0.0, 0.1, 0.0]


def message(channel: str, numbers: Sequence[float]) -> bytes:
    """Return a message of one of HOMIE's channels."""
    return KINDS[channel].kind.encode({KINDS[channel].field: list(numbers)})


class LcmStation(BridgeStation):
    """The bridge and all that it writes to the bus; `peer` speaks LCM on its port.

    Args:
        address: Of the bus.
        folder: For its last words.
    """

    def __init__(self, address: BusAddress, folder: Path) -> None:
        super().__init__("lcm", address, folder)
        self.port = free_port()
        self.peer = Multicast(port=self.port)

    def launch(self, *, inside: Sequence[str] = (), url: str = "", **settings: Any) -> None:
        """Start the server on its port."""
        super().launch(inside=inside, url=url, **{"port": self.port, **settings})

    def send(self, channel: str, numbers: Sequence[float]) -> None:
        """Send a message as a cockpit does."""
        assert self.peer.send(channel, message(channel, numbers)) == ""

    def close(self) -> None:
        """Kill what still runs, and leave the group."""
        super().close()
        self.peer.close()


@contextlib.contextmanager
def lcm_station(address: BusAddress, folder: Path) -> Iterator[LcmStation]:
    """Give a bridge that is closed at the end."""
    made = LcmStation(address, folder)
    try:
        yield made
    finally:
        made.close()
