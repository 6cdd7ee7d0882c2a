"""The bus server in virtual time answers and tells as the real one does: random commands are played to both."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Iterator
from typing import Any

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection, pack
from station.bus.notifications import enable_notifications, subscribe
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.waiting import wait_until

KEYS = ["a", "a@", "b", "station:estop", "empty"]
VALUES = [b"", b"0", b"\x00\xff\r\n", b"x" * 3000, b"[1.0, 2.0]"]
CHANNELS = [f"__keyspace@0__:{key}" for key in KEYS]
COMMANDS = 250


def command(rng: random.Random) -> list[Any]:
    """Return a random command, as the station and its tests use them."""
    key, other, value = rng.choice(KEYS), rng.choice(KEYS), rng.choice(VALUES)
    flags = "".join(rng.sample("KEg$lxeA", rng.randint(0, 5)))
    return rng.choice([
        ["SET", key, value], ["SET", key, value], ["SET", key, value, "NX"], ["SET", key, value, "XX"],
        ["SET", key, value, "PX", "60000"], ["MSET", key, value, f"{key}@", b"1 2 3 n"],
        ["MSET", key, value, other, b"twice"], ["GET", key], ["MGET", key, other, "absent"], ["DEL", key],
        ["DEL", key, key, other], ["GETDEL", key], ["RENAME", key, other], ["PEXPIRE", key, "60000"],
        ["CONFIG", "GET", "notify-keyspace-events"], ["CONFIG", "SET", "notify-keyspace-events", flags],
        ["CONFIG", "SET", "notify-keyspace-events", "K$gx"], ["CONFIG", "SET", "notify-keyspace-events", "Kq"],
        ["CONFIG", "GET", "no-such-setting"], ["PING"], ["PING", "now"], ["SELECT", "1"], ["SELECT", "0"],
        ["SELECT", "0"], ["MULTI"], ["EXEC"], ["EXEC"], ["UNLINK", key, other], ["APPEND", key, value],
        ["SETRANGE", key, "2", value], ["COPY", key, other], ["COPY", key, other, "REPLACE"], ["MOVE", key, "1"],
        ["DISCARD"], ["FLUSHDB"], ["FLUSHALL"],
    ])  # fmt: skip


class Side:
    """Two clients that write, and one that hears, of one of the two servers."""

    def __init__(self, address: BusAddress) -> None:
        self.lines = [Connection(address, timeout_s=10.0) for _ in range(2)]
        self.ear = Connection(address, timeout_s=10.0)
        self.lines[0].call("CONFIG", "SET", "notify-keyspace-events", "")
        assert enable_notifications(self.lines[0])
        subscribe(self.ear, CHANNELS, 10.0)

    def ask(self, line: int, request: list[Any]) -> str:
        return repr(self.lines[line].send_packed(pack(*request))[0])

    def told(self) -> list[Any]:
        """Return all that was told by now."""
        self.ear.send("PING", "end")
        told = []
        while (message := self.ear.receive(10.0)) != [b"pong", b"end"]:
            told.append(message)
        return told

    def close(self) -> None:
        for line in (*self.lines, self.ear):
            line.close()


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    """Virtual time."""
    with VirtualClock() as made:
        yield made


def side_by_side(real: BusAddress, network: Network) -> tuple[Side, Side]:
    return Side(real), Side(network.address())


@pytest.mark.parametrize("seed", range(12))
def test_both_servers_answer_and_tell_the_same(bus_server: BusAddress, seed: int) -> None:
    with VirtualClock(seed) as clock:
        network = Network(clock, latency_ns=(0, 50_000))
        rng = random.Random(seed)
        sides = side_by_side(bus_server, network)
        with contextlib.closing(sides[0]), contextlib.closing(sides[1]):
            for number in range(COMMANDS):
                line, request = rng.randrange(2), command(rng)
                real, virtual = (side.ask(line, request) for side in sides)
                assert virtual == real, f"seed {seed}, command {number}: {request}"
                heard, told = (side.told() for side in sides)
                assert told == heard, f"seed {seed}, what was told after command {number}: {request}"


def test_both_tell_that_a_key_has_expired(bus_server: BusAddress, clock: VirtualClock) -> None:
    real, virtual = side_by_side(bus_server, Network(clock))
    with contextlib.closing(real), contextlib.closing(virtual):
        for side in (real, virtual):
            side.ask(0, ["SET", "a", "1", "PX", "20"])
            side.ask(0, ["SET", "b", "1", "PX", "20"])
            side.ask(0, ["SET", "b", "2"])
            side.ask(0, ["SET", "station:estop", "1", "PX", "20"])
            side.ask(0, ["RENAME", "station:estop", "empty"])
        wait_until(lambda: (real.ask(0, ["GET", "a"]), real.ask(0, ["GET", "empty"])) == ("None", "None"))
        clock.sleep(0.021)
        request = ["MGET", "a", "b", "empty"]
        assert virtual.ask(0, request) == real.ask(0, request) == "[None, b'2', None]"
        assert sorted(virtual.told()) == sorted(real.told())


def test_both_scan_the_same_keys(bus_server: BusAddress, clock: VirtualClock) -> None:
    sides = side_by_side(bus_server, Network(clock))
    for side in sides:
        with contextlib.closing(side):
            for name in ("station:server:g1", "station:server:motion", "station:estop", "x"):
                side.ask(0, ["SET", name, "1"])
            cursor, found = side.lines[0].call("SCAN", "0", "MATCH", "station:server:*", "COUNT", "1000")
            assert (cursor, sorted(found)) == (b"0", [b"station:server:g1", b"station:server:motion"])


def test_both_refuse_other_commands_where_messages_are_heard(bus_server: BusAddress, clock: VirtualClock) -> None:
    answers = []
    for side in side_by_side(bus_server, Network(clock)):
        with contextlib.closing(side):
            answers.append(str(side.ear.send_packed(pack("GET", "a"))[0]))
    assert answers[0] == answers[1]
