"""The socket: messages of a multicast group, of one network interface alone, and when the kernel got each.

LCM has no authentication: whoever reaches the group may command. So this stays on the machine itself unless an
interface is named, hears that interface alone, and sends no further than into the network of that interface.
"""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import select
import socket
import struct
import sys
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from adapters.lcm.packet import Assembler, BadPacket, datagrams
from station.clock import SYSTEM, Clock
from station.errors import StationError

log = logging.getLogger(__name__)

GROUP, PORT = "239.255.76.67", 7667
"""Where LCM's programs meet unless they say otherwise."""

LOOPBACK = "127.0.0.1"

Sender = tuple[str, int]
"""IPv4 address and port. A process of LCM's library sends from one port of its own."""

_LARGEST = 65535
_BUFFER_BYTES = 4 << 20  # for the fragments of a long message, which come at once; the kernel may grant less
_MOST_READ = 200  # datagrams of one look: whoever sends faster does not keep a server from its other work
_IP_MULTICAST_ALL = 49  # linux/in.h
_SO_TIMESTAMPNS, _SO_TIMESTAMPING = 35, 37  # asm-generic/socket.h
_OF_ARRIVALS = 1 << 3 | 1 << 4  # linux/net_tstamp.h: by software, when they come
_STAMPS_WITHIN_S = 1.0
_TIMESPEC = struct.Struct("@ll")


class Received(NamedTuple):
    """A message.

    Attributes:
        channel: Its channel.
        message: Its bytes.
        sender: Who sent it.
        arrived_ns: When the kernel got it, on this machine's monotonic clock [ns].
    """

    channel: str
    message: bytes
    sender: Sender
    arrived_ns: int


class Multicast:
    """A member of a group.

    Args:
        group: IPv4 address of the group.
        port: UDP port of the group.
        interface: IPv4 address of this computer, in the network where the others are.
        peer: IPv4 address of the only computer that is heard; "" for all.
        clock: Of the arrivals.

    Attributes:
        address: Where its own messages come from.
        dropped: Datagrams that were no messages, by the reason.

    Raises:
        StationError: this computer has no such address, or the port is another program's alone.
    """

    def __init__(
        self,
        group: str = GROUP,
        port: int = PORT,
        *,
        interface: str = LOOPBACK,
        peer: str = "",
        clock: Clock = SYSTEM,
    ) -> None:
        self._to, self._peer, self._clock = (group, port), peer, clock
        self._assembler, self._sent = Assembler(), 0
        self.dropped = Counter[str]()
        here = socket.inet_aton(interface)
        reach = 0 if ipaddress.IPv4Address(interface).is_loopback else 1
        with contextlib.ExitStack() as undo:
            try:
                self._heard = undo.enter_context(_udp())
                self._heard.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
                self._heard.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # other members are on this computer
                if sys.platform == "linux":
                    self._heard.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)  # no other interface's
                    self._heard.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
                    _until_stamped(clock)
                self._heard.bind((group, port))
                member = socket.inet_aton(group) + here
                self._heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
                self._own = undo.enter_context(_udp())
                self._own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, here)
                self._own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, reach)
                self._own.bind((interface, 0))
                host, port = self._own.getsockname()
            except OSError as error:
                raise StationError(
                    f"lcm: {group}:{port} cannot be joined on {interface}: {error.strerror}; name with interface=… the "
                    "address that this computer has in the robot's network"
                ) from None
            undo.pop_all()
        self.address: Sender = (str(host), int(port))

    def send(self, channel: str, message: bytes) -> str:
        """Send a message; return why it could not be, or ""."""
        self._sent += 1
        try:
            for datagram in datagrams(self._sent, channel, message):
                self._own.sendto(datagram, self._to)
        except OSError as error:
            return str(error.strerror)
        return ""

    def receive(self, timeout_s: float) -> Iterator[Received]:
        """Yield the messages of others that have come, once one is there or a time has passed [s]."""
        select.select([self._heard], [], [], timeout_s)
        for _ in range(_MOST_READ):
            try:
                data, ancillary, _, sender = self._heard.recvmsg(_LARGEST, socket.CMSG_SPACE(_TIMESPEC.size))
            except BlockingIOError:
                return
            arrived_ns = self._arrival_ns(ancillary)
            if sender == self.address:
                continue
            if self._peer and sender[0] != self._peer:
                self.dropped["another computer"] += 1
                continue
            try:
                found = self._assembler.push(data, sender, arrived_ns * 1e-9)
            except BadPacket:
                self.dropped["not LCM"] += 1
                continue
            if found is not None:
                yield Received(*found, sender, arrived_ns)

    def close(self) -> None:
        """Leave the group."""
        self._heard.close()
        self._own.close()

    def _arrival_ns(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        """Return when the kernel got a datagram; where it does not say, now: it stamps by the wall clock."""
        now_ns = self._clock.monotonic_ns()
        for level, kind, data in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(data) == _TIMESPEC.size:
                seconds, nanoseconds = map(int, _TIMESPEC.unpack(data))
                return now_ns - max(0, self._clock.wall_ns() - (seconds * 1_000_000_000 + nanoseconds))
        return now_ns


def _until_stamped(clock: Clock) -> None:
    """Wait until the kernel notes when datagrams come, or for `_STAMPS_WITHIN_S`.

    It begins some time after it was asked to, on a busy machine tens of milliseconds, and says of what came before that
    it came when it was read: an old command would count as new.
    """
    end_s = clock.monotonic_s() + _STAMPS_WITHIN_S
    with _udp() as probe:
        probe.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, _OF_ARRIVALS)  # which leaves out what is not known
        probe.bind((LOOPBACK, 0))
        while clock.monotonic_s() < end_s:
            probe.sendto(b"", probe.getsockname())
            select.select([probe], [], [], _STAMPS_WITHIN_S)
            with contextlib.suppress(BlockingIOError):
                if probe.recvmsg(1, socket.CMSG_SPACE(3 * _TIMESPEC.size))[1]:
                    return
            clock.sleep(0.001)
    log.warning("lcm: this kernel does not say when a datagram came; what waited while we stood still counts as new")


def _udp() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    return made
