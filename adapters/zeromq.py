"""ZeroMQ's sockets as bridges need them: bounded, with an age for what waited, and nothing lost without a word.

ZeroMQ has no authentication, and says neither who sends nor when. So a message counts as come when it is read, unless
this process stood still before: then what waited counts as come when it last looked. Addresses are ``tcp://HOST:PORT``;
to listen on all of a computer's addresses is refused, one of them has to be named.
"""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Iterator, Sequence
from typing import Any

from adapters.pauses import Pauses
from station.clock import SYSTEM, Clock
from station.errors import StationError

EXTRA = "zmq"
"""Of our package, which brings the library."""

MOST_BYTES = 1 << 18
"""Of a message that is received; whoever sends more is cut off by the library."""

NOBODY = "nobody hears it"
"""Why a message was not sent that nobody has subscribed to."""

_BACKLOG = 64  # messages that wait here; more stay with the sender, which then drops its own
_MOST_READ = 200  # of one look: whoever sends faster does not keep a server from its other work
_QUEUED = 10  # messages of ours that wait for one reader
_SEND_BYTES = (
    16384  # that the kernel holds for a reader that does not read: seconds of old commands are worse than none
)
_BEAT_MS, _DEAD_MS = 500, 2000  # a peer whose cable was pulled is noticed, and reconnected to
_ADDRESS = re.compile(r"tcp://([A-Za-z0-9_.-]+|\[[0-9a-fA-F:]+\]|\*):([0-9]{1,5})")
_ANYWHERE = ("*", "0.0.0.0", "[::]")


def host_of(address: str) -> str:
    """Return the host of an address, without brackets."""
    found = _ADDRESS.fullmatch(address)
    return found.group(1).strip("[]") if found else ""


def expect_address(name: str, address: str, *, listens: bool) -> None:
    """Check an address of the settings.

    Args:
        name: Of the setting.
        address: What it says.
        listens: Whether we listen there, and others connect.

    Raises:
        ValueError: it is none; or it is all of this computer's.
    """
    example = "tcp://127.0.0.1:5556"
    found = _ADDRESS.fullmatch(address)
    if found is None or not 1 <= int(found.group(2)) <= 65535 or (not listens and found.group(1) == "*"):
        raise ValueError(f"{name} is {address!r}; expected an address such as {example}")
    if listens and found.group(1) in _ANYWHERE:
        raise ValueError(
            f"{name} is {address}: that listens on every network; expected the one address that this computer has "
            f"where the others are, or {example}"
        )


def library() -> Any:
    """Import pyzmq.

    Raises:
        StationError: it is not installed.
    """
    try:
        return importlib.import_module("zmq")
    except ImportError:
        raise StationError(
            f"ZeroMQ needs pyzmq, which is not installed; pip install 'teleop-station[{EXTRA}]'"
        ) from None


class Subscriber:
    """Hears a publisher, which may come and go.

    Args:
        address: Where it publishes.
        topics: What messages begin with that are wanted.
        clock: Of the arrivals.

    Raises:
        StationError: no pyzmq, or no such address.
    """

    def __init__(self, address: str, topics: Sequence[str], *, clock: Clock = SYSTEM) -> None:
        self._zmq = library()
        self._socket = open_socket(self._zmq, self._zmq.SUB)
        self._socket.setsockopt(self._zmq.RCVHWM, _BACKLOG)
        for topic in topics:
            self._socket.setsockopt(self._zmq.SUBSCRIBE, topic.encode())
        with explained(self._zmq, self._socket, address, "connected to"):
            self._socket.connect(address)
        self._poller = self._zmq.Poller()  # that of the socket itself is made anew for each look
        self._poller.register(self._socket, self._zmq.POLLIN)
        self._pauses = Pauses(clock)

    def receive(self, timeout_s: float) -> Iterator[tuple[bytes, float]]:
        """Yield messages and when they came [s], once one is there or a time has passed [s]."""
        self._pauses.begin()
        self._poller.poll(round(timeout_s * 1e3))
        self._pauses.end(timeout_s)
        is_empty = False
        for _ in range(_MOST_READ):
            if is_empty := not self._poller.poll(0):
                break
            yield b"".join(self._socket.recv_multipart(self._zmq.NOBLOCK)), self._pauses.came_s()
        self._pauses.done(is_empty=is_empty)

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


class Publisher:
    """Listens for subscribers and publishes to them; what one that does not read gets later is bounded.

    With several subscribers the slowest one decides whether a message is sent.

    Args:
        address: Where it listens.
        queued: Messages that wait for one subscriber here.
        kernel_bytes: That the kernel holds for it beside them.

    Attributes:
        subscribed: Beginnings of messages that they have subscribed to.

    Raises:
        StationError: no pyzmq, or it cannot listen there.
    """

    def __init__(self, address: str, *, queued: int, kernel_bytes: int) -> None:
        self._zmq = library()
        self.subscribed: set[bytes] = set()
        self._socket = open_socket(self._zmq, self._zmq.XPUB)
        self._socket.setsockopt(self._zmq.SNDHWM, queued)
        self._socket.setsockopt(self._zmq.SNDBUF, kernel_bytes)
        self._socket.setsockopt(self._zmq.XPUB_NODROP, 1)
        with explained(self._zmq, self._socket, address, "listened on"):
            self._socket.bind(address)

    def is_wanted(self, message: bytes) -> bool:
        """Whether anybody has subscribed to what a message begins with, as of the last `poll`."""
        return any(message.startswith(beginning) for beginning in self.subscribed)

    def send(self, message: bytes) -> str:
        """Send a message; return why it was not, or ""."""
        if not self.is_wanted(message):
            return NOBODY
        try:
            self._socket.send(message, self._zmq.NOBLOCK)
        except self._zmq.Again:
            return "who hears it does not read"
        return ""

    def poll(self) -> bool:
        """Take up who has come or gone; return whether anybody did."""
        is_changed = False
        for _ in range(_MOST_READ):
            try:
                told = b"".join(self._socket.recv_multipart(self._zmq.NOBLOCK))
            except self._zmq.Again:
                break
            if told[:1] == b"\1":
                self.subscribed.add(told[1:])
            elif told[:1] == b"\0":
                self.subscribed.discard(told[1:])
            is_changed = True
        return is_changed

    def close(self) -> None:
        """Listen no more; what was sent last is still delivered, where somebody reads it at once."""
        self._socket.close(linger=200)


def open_socket(zmq: Any, kind: int) -> Any:
    """Return a socket that notices a peer whose cable was pulled."""
    made = zmq.Context.instance().socket(kind)
    made.setsockopt(zmq.LINGER, 0)
    made.setsockopt(zmq.MAXMSGSIZE, MOST_BYTES)
    made.setsockopt(zmq.HEARTBEAT_IVL, _BEAT_MS)
    made.setsockopt(zmq.HEARTBEAT_TIMEOUT, _DEAD_MS)
    return made


@contextlib.contextmanager
def explained(zmq: Any, socket: Any, address: str, what: str) -> Iterator[None]:
    """Raise `StationError` where an address cannot be bound or connected to, and close the socket."""
    try:
        yield
    except zmq.ZMQError as error:
        socket.close()
        raise StationError(
            f"{address}: cannot be {what}: {error.strerror or error}; expected an address such as "
            "tcp://127.0.0.1:5556, of this computer and of a port that is free where we listen"
        ) from None
