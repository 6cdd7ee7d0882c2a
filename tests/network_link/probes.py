"""Numbered datagrams from one end of a link to the other: which came, in which order, and how long each took."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from typing import NamedTuple, Self

from tests.network_link.link import End, Link
from tests.waiting import wait_until

_PORT = 4711
_PROBE = struct.Struct("<qq")
_MOST_WAITING = 100  # datagrams that the kernel keeps for the cable, with room


class Arrival(NamedTuple):
    """A probe that came: its number, and how long it took [s]."""

    number: int
    took_s: float


class Probes:
    """A context manager.

    Args:
        link: That is tried.
        sender, receiver: Its ends.
        group: Multicast group that the receiver has joined, and is sent to; "" for its address.
    """

    def __init__(self, link: Link, sender: End, receiver: End, group: str = "") -> None:
        self._link, self._from, self._to, self._group = link, sender, receiver, group
        self.arrivals: list[Arrival] = []
        self._numbers = 0

    def __enter__(self) -> Self:
        self._out, self._in = self._from.socket(), self._to.socket()
        self._in.bind((self._group or self._to.address, _PORT))
        self._in.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        if self._group:
            own = socket.inet_aton(self._group) + socket.inet_aton(self._to.address)
            self._in.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, own)
            sender = socket.inet_aton(self._from.address)
            self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, sender)
        self._in.settimeout(0.05)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._receive)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()
        self._out.close()
        self._in.close()

    def send(self, count: int, every_s: float = 0.0, *, is_waited_for: bool = True) -> None:
        """Send some, and return once none of them is on the way; an end without a carrier drops them itself."""
        for _ in range(count):
            with contextlib.suppress(OSError):
                self._out.sendto(
                    _PROBE.pack(self._numbers, time.monotonic_ns()), (self._group or self._to.address, _PORT)
                )
            self._numbers += 1
            if every_s:
                time.sleep(every_s)
            elif self._numbers % _MOST_WAITING == 0:
                self._wait_still()
        if is_waited_for:
            self._wait_still()

    def greet(self) -> None:
        """Have both ends know each other's Ethernet addresses: until then the kernel holds datagrams back."""
        own = self._numbers
        self.send(1)
        wait_until(lambda: own in self.numbers)

    @property
    def numbers(self) -> list[int]:
        """Of those that came, in the order in which they did."""
        return [arrival.number for arrival in self.arrivals]

    def _wait_still(self) -> None:
        """Wait until no frame waits in the kernel, nor on the cable."""

        def is_still() -> bool:
            first, second = self._link.counts(self._from), self._link.counts(self._from)
            return first == second and first.came == first.delivered + first.lost + first.cut

        wait_until(is_still)

    def _receive(self) -> None:
        while not self._is_over.is_set():
            with contextlib.suppress(TimeoutError):
                number, sent_ns = _PROBE.unpack(self._in.recv(64))
                self.arrivals.append(Arrival(number, (time.monotonic_ns() - sent_ns) * 1e-9))
