"""The bus of a station: found where it was named, found running, or started."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from station.bus import address as addresses
from station.bus.address import BusAddress
from station.bus.connection import Connection, ConnectionLost
from station.bus.keeper import KeptServer, OnRestart
from station.bus.redis_server import remove_dead
from station.bus.server_options import ServerOptions

log = logging.getLogger(__name__)


@contextmanager
def found_or_started(
    named: BusAddress | None, *, tcp_port: int | None = None, on_restart: OnRestart | None = None
) -> Iterator[BusAddress]:
    """Give the address of a server that answers; one that we start is kept alive, and ends with the block.

    Args:
        named: The bus that the user named; it must answer. None takes this user's own, started when it is not there.
        tcp_port: Loopback port to open beside the socket of a server that we start, for stock scripts.
        on_restart: Called, in another thread, when a server that we started had to be started again.

    Raises:
        BusError: the named bus does not answer or refuses us, or no server could be started.
    """
    address = named or addresses.default()
    is_own = address == addresses.own()
    try:
        Connection(address, timeout_s=1.0).close()
    except ConnectionLost:
        if not is_own:
            raise
    else:
        yield address
        return
    remove_dead(addresses.bulk_beside(addresses.runtime_folder() / "bus.sock"))
    with KeptServer.start(own_options(tcp_port), on_restart) as server:
        yield server.address


def own_options(tcp_port: int | None = None) -> ServerOptions:
    """Return how this user's own server is started."""
    folder = addresses.runtime_folder()
    return ServerOptions(folder=folder, socket=Path(folder) / "bus.sock", tcp_port=tcp_port)
