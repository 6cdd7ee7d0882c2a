"""A foreign writer, and a way to collect what a tap saw."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.tap import Tap, Write
from tests.waiting import DEADLINE_S


@pytest.fixture
def writer(bus_server: BusAddress) -> Iterator[Connection]:
    """A connection that knows nothing of the station."""
    connection = Connection(bus_server, timeout_s=10.0)
    yield connection
    connection.close()


Collect = Callable[[Tap], list[Write]]


@pytest.fixture
def collect(writer: Connection) -> Collect:
    """Return all that a tap saw before a key that is written now."""

    def until_mark(tap: Tap) -> list[Write]:
        writer.call("SET", "test:mark", "1")
        seen: list[Write] = []
        deadline = time.monotonic() + DEADLINE_S
        while not any(write.key == "test:mark" for write in seen):
            assert time.monotonic() < deadline, f"the mark did not come; seen so far: {seen[-3:]}"
            seen += tap.read(0.5)
        writer.call("DEL", "test:mark")
        while not any(write.key == "test:mark" and write.value is None for write in seen):
            assert time.monotonic() < deadline, "the end of the mark did not come"
            seen += tap.read(0.5)
        return [write for write in seen if write.key != "test:mark"]

    return until_mark
