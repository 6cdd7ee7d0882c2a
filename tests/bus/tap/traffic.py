"""Traffic for a tap, and what came of it."""

from __future__ import annotations

import random
import socket
import time
from pathlib import Path

from station.bus.address import BusAddress
from station.bus.connection import Connection, pack
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Tap, Write
from tests.waiting import wait_until

Content = tuple[str, bytes | None, bytes | None]


def random_writes(count: int, *, big_every: int = 100) -> list[Content]:
    """Foreign and native writes of random bytes, with 60 KB ones in between."""
    dice = random.Random(count)
    writes: list[Content] = []
    for number in range(count):
        size = 60_000 if number % big_every == big_every - 1 else dice.choice((0, 1, 9, 10, 99, 100, 550, 1500))
        stamp = b"%d 1 2 test.1.00000000.0000" % number if dice.random() < 0.5 else None
        writes.append((f"key_{dice.randrange(8)}", dice.randbytes(size), stamp))
    return writes


def packed(writes: list[Content]) -> bytes:
    """Return the requests that write all that."""
    return b"".join(
        pack("SET", key, value or b"") if stamp is None else pack("MSET", key, value or b"", f"{key}@", stamp)
        for key, value, stamp in writes
    )


def write_all(writer: Connection, writes: list[Content]) -> None:
    """Write as fast as the server takes it."""
    for start in range(0, len(writes), 100):
        part = writes[start : start + 100]
        writer.send_packed(packed(part), len(part))


def write_slowly(address: BusAddress, writes: list[Content]) -> None:
    """Write in small portions, as other processes of a station do."""
    connection = Connection(address, timeout_s=10.0)
    for start in range(0, len(writes), 20):
        part = writes[start : start + 20]
        connection.send_packed(packed(part), len(part))
        time.sleep(0.002)
    connection.close()


def content(writes: list[Write]) -> list[Content]:
    """Leave the time of arrival away."""
    return [write[:3] for write in writes]


def read(tap: Tap, count: int) -> list[Write]:
    """Return at least so many writes."""
    seen: list[Write] = []
    wait_until(lambda: seen.extend(tap.read(0.1)) or len(seen) >= count)
    return seen


def read_until_lost(tap: Tap) -> None:
    """Read until the tap raises."""
    wait_until(lambda: tap.read(0.1) is None)


def info(connection: Connection) -> dict[str, str]:
    """Return what the server says of its replication and its counters."""
    lines = connection.call("INFO", "replication").decode() + connection.call("INFO", "stats").decode()
    return dict(line.split(":", 1) for line in lines.splitlines() if ":" in line)


def free_port() -> int:
    """Return a TCP port that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def start_server(folder: Path) -> RedisServer:
    """Start a server of one's own, to be killed or frozen."""
    return RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
