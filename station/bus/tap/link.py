"""The replication link: we say that we are a replica, skip the snapshot, and get the server's stream of writes.

A server cuts a replica off that does not acknowledge for ``repl-timeout`` (60 s by default), and holds the stream back
after a snapshot until an acknowledgement comes that is not too early. So a thread of the link's own acknowledges for
the whole life of the link, however long the reader of the stream is held up.
"""

from __future__ import annotations

import select
import socket
import ssl
import threading

from station.bus.address import BusAddress
from station.bus.connection import ConnectionLost, pack
from station.bus.tap.base import Position, TapRefused, connect
from station.clock import Thread
from station.errors import BusError

_ACK_S = 1.0
_FIRST_ACK_S = 0.05  # after a snapshot, until data come: a single early acknowledgement is ignored by the server
_SNAPSHOT_SILENCE_S = 20.0  # a foreign server may wait 5 s for other replicas, and keeps alive every 10 s meanwhile
# At thousands of writes a second, being woken for each costs more than the writes; so let a few come together. Below
# 2,000 a second, and for short bursts, the stamp of arrival is not delayed.
_BUSY_GAP_S = 0.0005
_BUSY_STREAK = 32
_BUSY_PAUSE_S = 0.00025
_EOF_MARKER_SIZE = 40
_LINE_LIMIT = 512
_FOR_NOW = ("-LOADING", "-NOMASTERLINK", "-MASTERDOWN", "-BUSY", "-TRYAGAIN")  # a server on its way up, not a refusal
_WOULD_BLOCK = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


class Link:
    """An open link at the first byte of the stream.

    Attributes:
        replication_id: The server's history that the stream belongs to.
        offset: Bytes of that history that the reader has consumed; the reader keeps it up to date for the
            acknowledgements.
        is_resumed: Whether the stream goes on behind the position that was asked for.
        silence_limit_s: After this long without a byte the link counts as lost [s].

    Raises:
        TapRefused: the server does not let us be a replica.
        ConnectionLost: the server cannot be reached or went away.
    """

    def __init__(self, address: BusAddress, resume: Position | None) -> None:
        self._address, self._clock = address, address.clock
        self._socket = _introduce(address)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        self._lock = threading.Lock()  # a TLS socket must not be read and written at the same time
        self._is_plain = not isinstance(self._socket, ssl.SSLSocket)
        self._is_drained = False  # nothing is left to take before the next wait; TLS may keep bytes of its own back
        self._streak = 0  # how often in a row bytes came within _BUSY_GAP_S
        self._unsent = b""
        self._early = bytearray()  # what came behind the line or the snapshot that was being read
        self._buffer = memoryview(bytearray(1 << 20))
        self._closed = threading.Event()
        self._has_data = False
        self._heard_at = self._clock.monotonic_s()
        self.silence_limit_s = _SNAPSHOT_SILENCE_S
        self._acknowledger: Thread | None = None
        try:
            self.replication_id, self.offset, self.is_resumed = self._request(resume)
            self._acknowledger = self._clock.start(self._acknowledge_for_life, "tap-ack")
            if not self.is_resumed:
                self._skip_snapshot()
        except BaseException:
            self.close()
            raise

    def receive(self, timeout_s: float) -> memoryview:
        """Return the next bytes of the stream, valid until the next call; empty when none came in time.

        Raises:
            ConnectionLost: the server went away or has been silent for too long.
        """
        if self._early:
            data = memoryview(self._early)
            self._early = bytearray()
        else:
            data = self._receive_some(timeout_s)
        self._has_data = self._has_data or len(data) > 0
        return data

    def acknowledge(self) -> None:
        """Acknowledge to the server how far we are.

        A failure is not reported here: the reader of the stream meets the same one.
        """
        with self._lock:
            # What a full socket did not take must be sent first, whole, before anything else.
            data = self._unsent or pack("REPLCONF", "ACK", self.offset)
            try:
                self._unsent = data[self._socket.send(data) :]
            except _WOULD_BLOCK:
                self._unsent = data
            except OSError:
                self._closed.set()

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._closed.set()
        if self._acknowledger is not None:
            self._clock.join(self._acknowledger)
        self._socket.close()

    def _acknowledge_for_life(self) -> None:
        while not self._clock.wait(self._closed, _ACK_S if self._has_data else _FIRST_ACK_S):
            self.acknowledge()

    def _request(self, resume: Position | None) -> tuple[str, int, bool]:
        """Ask for the stream; returns its history's id, the offset before its first byte, and whether it resumes."""
        wanted = (resume.replication_id, resume.offset + 1) if resume is not None else ("?", -1)
        with self._lock:
            self._socket.send(pack("PSYNC", *wanted))
        try:
            answer = self._line()
        except ConnectionLost as error:
            raise TapRefused(f"bus {self._address} hung up when asked for its replication stream ({error})") from error
        kind, *fields = answer.split()
        if kind == "+FULLRESYNC" and len(fields) == 2:
            return fields[0], int(fields[1]), False
        if kind == "+CONTINUE" and resume is not None:
            return fields[0] if fields else resume.replication_id, resume.offset, True
        if answer.startswith(_FOR_NOW):
            raise BusError(f"bus {self._address} has no replication stream yet: {answer.lstrip('-')}")
        raise TapRefused(f"bus {self._address} refuses its replication stream: {answer.lstrip('-')}")

    def _skip_snapshot(self) -> None:
        header = self._line()
        if header.startswith("$EOF:") and len(header) == len("$EOF:") + _EOF_MARKER_SIZE:
            self._skip_until(header.removeprefix("$EOF:").encode())
        elif header.startswith("$") and header[1:].isdigit():
            self._skip_bytes(int(header[1:]))
        else:
            raise BusError(f"bus {self._address}: expected a snapshot, got {header[:60]!r}")

    def _skip_bytes(self, count: int) -> None:
        while len(self._early) < count:
            count -= len(self._early)
            self._early.clear()
            self._early += self._receive_some(_SNAPSHOT_SILENCE_S)
        del self._early[:count]

    def _skip_until(self, marker: bytes) -> None:
        while (found := self._early.find(marker)) < 0:
            del self._early[: -len(marker)]  # its beginning may be here already
            self._early += self._receive_some(_SNAPSHOT_SILENCE_S)
        del self._early[: found + len(marker)]

    def _line(self) -> str:
        """Return the next line; empty ones keep the link alive while the server prepares, and are skipped."""
        while True:
            line, end, rest = self._early.partition(b"\n")
            if not end:
                if len(line) > _LINE_LIMIT:
                    raise BusError(f"bus {self._address}: expected a line, got {bytes(line[:60])!r}…")
                self._early += self._receive_some(_SNAPSHOT_SILENCE_S)
                continue
            self._early = rest
            if text := line.strip():
                return text.decode("utf-8", "replace")

    def _receive_some(self, timeout_s: float) -> memoryview:
        """Return at least one byte, or none when the time-out comes before the limit of silence."""
        deadline = self._clock.monotonic_s() + timeout_s
        while True:
            if self._is_drained:
                if self._streak >= _BUSY_STREAK:
                    self._clock.sleep(_BUSY_PAUSE_S)
                if not self._wait(deadline):
                    return self._buffer[:0]
            try:
                with self._lock:
                    count = self._socket.recv_into(self._buffer)
            except _WOULD_BLOCK:
                self._is_drained = True
                continue
            except OSError as error:
                raise ConnectionLost(f"bus {self._address}: {error.strerror or error}") from error
            if count == 0:
                raise ConnectionLost(f"bus {self._address}: the server closed the replication link")
            self._is_drained = self._is_plain and count < len(self._buffer)
            now = self._clock.monotonic_s()
            self._streak = self._streak + 1 if now - self._heard_at < _BUSY_GAP_S else 0
            self._heard_at = now
            return self._buffer[:count]

    def _wait(self, deadline: float) -> bool:
        """Wait until there may be bytes; False when the deadline has passed."""
        while True:
            now = self._clock.monotonic_s()
            dead_at = self._heard_at + self.silence_limit_s
            # Look before judging: a reader that was held up finds a lot here, although it has heard nothing for long.
            if self._poll.poll(max(0.0, (min(deadline, dead_at) - now) * 1e3)):
                return True
            now = self._clock.monotonic_s()
            if now >= dead_at:
                limit_s = self.silence_limit_s
                raise ConnectionLost(f"bus {self._address}: silent for {limit_s:.0f} s; frozen or unreachable")
            if now >= deadline:
                return False


def _introduce(address: BusAddress) -> socket.socket:
    connection = connect(address)
    try:
        # eof: the snapshot may come without its length; psync2: the history may change its id when we resume
        connection.call("REPLCONF", "capa", "eof", "capa", "psync2")
        stream = connection.detach()
    except ConnectionLost:
        raise
    except BusError as error:
        raise TapRefused(f"bus {address} refuses replicas: {error}") from error
    finally:
        connection.close()
    stream.setblocking(False)
    return stream
