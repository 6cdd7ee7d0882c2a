"""What the tapped database holds at one place of the stream: read and marked by a probe in one transaction."""

from __future__ import annotations

import logging
from itertools import islice

from station.bus.connection import Connection, ConnectionLost, pack
from station.bus.tap.base import MOST_KEYS, PROBE, PROBE_LIFE_MS, Snapshot, new_token
from station.errors import BusError

log = logging.getLogger(__name__)

_SCAN_COUNT = 1000
_MOST_BYTES = 64 << 20
_LARGEST = 1 << 20  # bytes of one value


def taken(connection: Connection) -> Snapshot | None:
    """Write a probe, and read what there was at that instant.

    A key that is made between the listing and the transaction is not in it; the stream of a link that was open before
    tells of it.

    Returns:
        The snapshot; None where this user may not do all of it: nothing was written then.

    Raises:
        ConnectionLost: the server is gone.
    """
    try:
        names, is_whole = _names(connection)
        wanted, unread = _small(connection, names)
        connection.call("MULTI")
        token, values = _probe_and_read(connection, wanted)
    except ConnectionLost:
        raise
    except BusError as error:
        log.info("what keys hold is not known before they are written: %s", error)
        connection.send_packed(pack("DISCARD"))
        return None
    held = {key: value for key, value in zip(wanted, values, strict=True) if value is not None}
    return Snapshot(token, held, unread, is_whole)


def _probe_and_read(connection: Connection, wanted: list[bytes]) -> tuple[bytes, list[bytes | None]]:
    """Do what is done in the transaction that is open; return the probe's value, and those that were wanted."""
    token = new_token()
    requests: list[tuple[bytes | str | int, ...]] = [("SET", PROBE, token, "PX", PROBE_LIFE_MS)]
    if wanted:
        requests.append(("MGET", *wanted))
    *_, done = connection.pipeline([*requests, ("EXEC",)])
    return token, done[1] if wanted else []


def _names(connection: Connection) -> tuple[list[bytes], bool]:
    """Return the names of the keys, and whether these are all."""
    found: dict[bytes, None] = {}
    cursor = b"0"
    while True:
        cursor, page = connection.call("SCAN", cursor, "COUNT", _SCAN_COUNT)
        found.update(dict.fromkeys(page))
        if cursor == b"0" or len(found) > MOST_KEYS:
            return list(islice(found, MOST_KEYS)), cursor == b"0" and len(found) <= MOST_KEYS


def _small(connection: Connection, names: list[bytes]) -> tuple[list[bytes], tuple[bytes, ...]]:
    """Return the names of strings that are read, and of those that would take too much memory."""
    sizes = connection.send_packed(b"".join(pack("STRLEN", name) for name in names), len(names))
    wanted, unread, total = [], [], 0
    for name, size in zip(names, sizes, strict=True):
        if isinstance(size, int) and size <= _LARGEST and total + size <= _MOST_BYTES:
            wanted.append(name)
            total += size
        else:
            unread.append(name)
    return wanted, tuple(unread)
