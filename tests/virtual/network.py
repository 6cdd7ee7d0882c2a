"""A network in virtual time, and the bus server on it: latency, lines that freeze and are cut, restarts.

It stands in for sockets alone: all above is the station's own code.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from station.bus.address import BusAddress
from tests.virtual.clock import Process, VirtualClock
from tests.virtual.server import Client, Server

_CAPACITY = 200_000  # bytes that a line holds which nobody reads, as a unix socket's
_REFUSED = ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")


@dataclass
class Link:
    """What connects a process with the bus, all its lines alike.

    Attributes:
        latency_ns: Least and greatest time that bytes take one way [ns].
        fragments: Whether bytes go and come in pieces of any size.
        frozen_until_ns: Nothing passes before this instant; then all of it does, at once.
        is_refused: Whether no new line can be opened.
    """

    latency_ns: tuple[int, int]
    fragments: bool = False
    frozen_until_ns: int = 0
    is_refused: bool = False


class Network:
    """A bus and the lines to it.

    Args:
        clock: Its time.
        latency_ns: Of every process's link that is given none of its own.
        name: Of the bus, in its address.
    """

    def __init__(self, clock: VirtualClock, latency_ns: tuple[int, int] = (0, 0), name: str = "virtual") -> None:
        self.clock = clock
        self.server = Server(clock, clock.call_at)
        self._name, self._latency_ns = name, latency_ns
        self._links: dict[Process, Link] = {}
        self._streams: list[Stream] = []
        self._frozen_until_ns = 0  # the server
        self._up_ns = 0

    def address(self, db: int = 0) -> BusAddress:
        """Return where the bus is."""
        return VirtualAddress(host=self._name, db=db, network=self)

    def link(self, process: Process) -> Link:
        """Return the link of a process."""
        return self._links.setdefault(process, Link(self._latency_ns))

    def freeze(self, process: Process, seconds: float) -> None:
        """Let nothing pass between a process and the bus for a time [s]; then all of it passes."""
        link = self.link(process)
        link.frozen_until_ns = max(link.frozen_until_ns, self.clock.monotonic_ns() + round(seconds * 1e9))

    def cut(self, process: Process) -> None:
        """Cut all lines of a process; what is under way is lost, and new ones can be opened at once."""
        for stream in [stream for stream in self._streams if stream.process is process]:
            stream.reset()

    def freeze_server(self, seconds: float) -> None:
        """Let the server do nothing for a time [s]; then it does all that was asked meanwhile."""
        self._frozen_until_ns = max(self._frozen_until_ns, self.clock.monotonic_ns() + round(seconds * 1e9))

    def restart_server(self, down_s: float) -> None:
        """Kill the server, which forgets all, and start another one after a time [s]."""
        self._up_ns = self.clock.monotonic_ns() + round(down_s * 1e9)
        self.server.forget_all()

    def open(self, timeout_s: float) -> Stream:
        """Open a line for the process that runs."""
        link, began_ns = self.link(self.clock.process), self.clock.monotonic_ns()
        done_ns = max(began_ns + sum(link.latency_ns) // 2, link.frozen_until_ns)
        self.clock.hold("a connection", None, min(done_ns, began_ns + round(timeout_s * 1e9)))
        if self.clock.monotonic_ns() < link.frozen_until_ns:
            raise TimeoutError("timed out")
        if link.is_refused or self.clock.monotonic_ns() < self._up_ns:
            raise _REFUSED
        stream = Stream(self, link, self.clock.process)
        self._streams.append(stream)
        return stream

    def passes_ns(self, link: Link) -> int:
        """Return the instant before which nothing of a link reaches the other end."""
        return max(link.frozen_until_ns, self._frozen_until_ns)

    @property
    def free_ns(self) -> int:
        """The instant from which no link is frozen and what was held has passed."""
        return max(self.passes_ns(link) for link in self._links.values())

    def forget(self, stream: Stream) -> None:
        """Let go of a line that is closed."""
        if stream in self._streams:
            self._streams.remove(stream)


class VirtualAddress(BusAddress, frozen=True, kw_only=True):
    """The address of a bus on a network in virtual time."""

    network: Network

    @property
    def is_local(self) -> bool:
        """True: what runs here is written for a bus on the same machine, whose line may freeze."""
        return True

    @property
    def clock(self) -> VirtualClock:  # type: ignore[override]
        return self.network.clock

    def open(self, timeout_s: float) -> Stream:  # type: ignore[override]
        return self.network.open(timeout_s)


class _Pipe:
    """One direction of a line: bytes come whole, in order, after the link's latency, and not while it is frozen."""

    def __init__(self, network: Network, link: Link, sink: Callable[[bytes], None]) -> None:
        self._network, self._link, self._sink = network, link, sink
        self._under_way: deque[tuple[int, bytes]] = deque()
        self._is_closed = False
        self.held = 0  # bytes under way

    def put(self, data: bytes) -> None:
        """Send bytes; none at all for the end of the stream."""
        clock, (least_ns, most_ns) = self._network.clock, self._link.latency_ns
        due_ns = clock.monotonic_ns() + (clock.random.randint(least_ns, most_ns) if most_ns else 0)
        if self._under_way:
            due_ns = max(due_ns, self._under_way[-1][0])
        self._under_way.append((due_ns, data))
        self.held += len(data)
        if due_ns > clock.monotonic_ns():
            clock.call_at(due_ns, self._deliver)
        else:
            self._deliver()

    def close(self) -> None:
        """Lose what is under way."""
        self._is_closed = True
        self._under_way.clear()
        self.held = 0

    def _deliver(self) -> None:
        clock = self._network.clock
        now_ns = clock.monotonic_ns()
        if self._under_way and (free_ns := self._network.passes_ns(self._link)) > now_ns:
            clock.call_at(free_ns, self._deliver)
            return
        while self._under_way and self._under_way[0][0] <= now_ns and not self._is_closed:
            _, data = self._under_way.popleft()
            self.held -= len(data)
            self._sink(data)


class Stream:
    """A process's end of a line: as much of a socket as `station.bus.connection` uses."""

    def __init__(self, network: Network, link: Link, process: Process) -> None:
        self.process = process
        self._network, self._link, self._clock = network, link, network.clock
        self._timeout_s: float | None = None
        self._came = bytearray()
        self._is_ended = self._is_closed = False
        self._error: OSError | None = None
        self._here = _Pipe(network, link, self._arrive)
        self._there = _Pipe(network, link, self._reach)
        self._client: Client | None = Client(network.server, self._here.put, self._hang_up_there)
        process.on_kill.append(self.close)

    def settimeout(self, timeout_s: float | None) -> None:
        self._timeout_s = timeout_s

    def fileno(self) -> int:
        return -1 if self._is_closed else 1_000_000

    def send(self, data: bytes | bytearray) -> int:
        self._expect_open()
        if self._there.held >= _CAPACITY:
            self._wait("room on the line", lambda: self._there.held < _CAPACITY or self._is_gone())
            self._expect_open()
        size = min(len(data), _CAPACITY - self._there.held)
        if self._link.fragments and size > 1:
            size = 1 + int(self._clock.random.random() * size)  # one draw, however long names are
        self._there.put(bytes(data[:size]))
        return size

    def sendall(self, data: bytes) -> None:
        sent = 0
        while sent < len(data):
            sent += self.send(data[sent:])

    def recv(self, size: int) -> bytes:
        self._expect_open()
        if not self._has_come():
            self._wait("bytes from the bus", self._has_come)
        if self._came:
            if self._link.fragments:
                size = 1 + int(self._clock.random.random() * min(size, len(self._came)))
            data = bytes(self._came[:size])
            del self._came[:size]
            return data
        self._expect_open()
        return b""

    def shutdown(self, how: int) -> None:
        self._expect_open()
        self._is_ended = True
        self._there.put(b"")

    def close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            self._here.close()
            self._there.put(b"")
            self._network.forget(self)

    def reset(self) -> None:
        """Cut the line."""
        self._error = ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")
        self._there.close()
        self._here.close()
        self._reach(b"")
        self._network.forget(self)

    def _has_come(self) -> bool:
        return bool(self._came) or self._is_ended or self._is_gone()

    def _is_gone(self) -> bool:
        return self._is_closed or self._error is not None

    def _expect_open(self) -> None:
        if self._is_closed:
            raise OSError(errno.EBADF, "Bad file descriptor")
        if self._error is not None:
            raise self._error

    def _wait(self, what: str, is_ready: Callable[[], bool]) -> None:
        if self._timeout_s == 0.0:
            raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
        deadline_ns = None
        if self._timeout_s is not None:
            deadline_ns = self._clock.monotonic_ns() + max(1, round(self._timeout_s * 1e9))
        if not self._clock.hold(what, is_ready, deadline_ns):
            raise TimeoutError("timed out")

    def _arrive(self, data: bytes) -> None:
        if data:
            self._came += data
        else:
            self._is_ended = True

    def _reach(self, data: bytes) -> None:
        """Bytes reach the server; none at all is the end of the stream."""
        client = self._client
        if client is None:
            return
        if data:
            client.feed(data)
        else:
            self._client = None
            client.close()

    def _hang_up_there(self) -> None:
        """The server hangs up, or has seen that we did."""
        if self._client is not None:
            self._client = None
            self._here.put(b"")
