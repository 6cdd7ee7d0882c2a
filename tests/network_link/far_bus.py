"""A bus on the computer at one end of a cable, as a process at another end reaches it, and as one beside it does."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import msgspec

from station.bus import password_file
from station.bus.address import BusAddress
from tests.cli.running import Home, new_home
from tests.network_link.link import End, Link
from tests.waiting import bus_answers, wait_until

ADDRESSES = ("192.168.7.1", "192.168.7.2", "192.168.7.3")
"""The first is where the bus is."""
PORT = 6379


class FarAddress(BusAddress, frozen=True, kw_only=True):
    """A bus as it is reached from an end of a cable, by a process of this computer.

    Attributes:
        end: The end.
    """

    end: End

    def open(self, timeout_s: float) -> socket.socket:
        """Connect within a time [s]."""
        stream = self.end.socket(socket.SOCK_STREAM)
        stream.settimeout(max(timeout_s, 0.5))
        stream.connect((self.host, self.port))
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return stream


class FarBus(NamedTuple):
    """A bus at the first end of a cable.

    Attributes:
        link: The cable.
        home: Where commands run beside the bus.
        here: Its address beside it.
        there: Its address at the second end.
        secret: File with its password.
    """

    link: Link
    home: Home
    here: BusAddress
    there: FarAddress
    secret: Path


def opened_bus(home: Home) -> BusAddress:
    """Wait for a bus that is open to the network; return where it is beside it, with its password."""
    secret = password_file.beside(Path(home.bus.socket or ""))
    wait_until(secret.exists)
    here = msgspec.structs.replace(home.bus, password=next(iter(password_file.read(secret).values())))
    wait_until(lambda: bus_answers(here))
    return here


@contextmanager
def far_bus(seed: int = 0, ends: int = 2) -> Iterator[FarBus]:
    """Lay the cable, and start the bus at its first end."""
    with (
        Link(ADDRESSES[:ends], seed=seed) as link,
        new_home(link.ends[0].prefix) as home,
        home.running("bus", "start", "--bind", ADDRESSES[0]),
    ):
        secret = password_file.beside(Path(home.bus.socket or ""))
        here = opened_bus(home)
        there = FarAddress(host=ADDRESSES[0], port=PORT, password=here.password, end=link.ends[1])
        yield FarBus(link, home, here, there, secret)
