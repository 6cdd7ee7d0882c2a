"""One connection to the server: pre-encoded requests, hiredis for the replies, every wait bounded.

A general client spends about 100 of its 120 microseconds per request on bookkeeping that a dedicated connection does
not need (retries, pools, locks; `docs/performance.md` has the figures), and hides a dead server behind its retries.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
from collections.abc import Sequence
from typing import Any

import hiredis

from station.bus.address import CERTIFICATE_VARIABLE, KEY_VARIABLE, BusAddress
from station.errors import BusError

_READ_SIZE = 1 << 16
_FAR_OPEN_S = 2.5  # to connect over a line that loses packets: the kernel asks again after 1 s
_MOST_UNSENT = 8 << 20  # bytes; a G1 server fills them in 13 s

Argument = bytes | str | int


def pack(*arguments: Argument) -> bytes:
    """Encode one request in the server's protocol (RESP)."""
    return b"*%d\r\n" % len(arguments) + b"".join(map(bulk, arguments))


def bulk(argument: Argument) -> bytes:
    """Encode one argument of a request."""
    data = argument if isinstance(argument, bytes) else str(argument).encode("utf-8", "surrogateescape")
    return b"$%d\r\n%b\r\n" % (len(data), data)


class ConnectionLost(BusError):
    """The server went away, or did not answer in time."""


class Connection:
    """A connection that one thread at a time uses.

    Args:
        address: Where the server is.
        timeout_s: Longest wait for connecting and for each answer [s].
    """

    def __init__(self, address: BusAddress, *, timeout_s: float = 0.05) -> None:
        self.address = address
        self.owed = 0  # answers of posted requests that have not come yet
        self._unsent = bytearray()  # of posted requests, while the line is full
        self._timeout_s = timeout_s
        self._waits_s: float | None = timeout_s  # of the socket, at present
        self._reader = hiredis.Reader()
        self._socket = self._open()
        try:
            self._greet()
        except ConnectionLost as error:
            self.close()
            if not address.tls or address.certificate_file is not None:
                raise
            raise ConnectionLost(  # TLS 1.3 is refused after it seemed to be there, and not always with a reason
                f"{error}; it may ask for a certificate of ours: name that in ${CERTIFICATE_VARIABLE}, its key in "
                f"${KEY_VARIABLE}"
            ) from error
        except BaseException:
            self.close()
            raise

    def call(self, *arguments: Argument) -> Any:
        """Send one request and return its answer (bytes, int, list, None).

        Raises:
            ConnectionLost: the server went away or did not answer in time; the connection is then closed.
            BusError: the server answered with an error.
        """
        return _checked(self.send_packed(pack(*arguments))[0])

    def pipeline(self, requests: Sequence[Sequence[Argument]]) -> list[Any]:
        """Send several requests at once and return their answers in order."""
        replies = self.send_packed(b"".join(pack(*request) for request in requests), len(requests))
        return [_checked(reply) for reply in replies]

    def send_packed(self, data: bytes, replies: int = 1) -> list[Any]:
        """Send encoded requests and return that many answers; an error answer is returned, not raised."""
        try:
            self._wait(self._timeout_s)
            self._socket.sendall(data)
            return [self._next() for _ in range(replies)]
        except OSError as error:
            self.close()
            raise ConnectionLost(f"bus {self.address}: {_reason(error)}") from error

    def post(self, data: bytes, count: int = 1, *, wait_s: float) -> list[Any]:
        """Send encoded requests, so many as `count`, and wait for their answers no longer than a time.

        While the answer to an earlier one is still owed there is no wait at all, and what the line does not take now
        is kept and sent by a later call: a server that stalls costs its writer one wait, and loses nothing.

        Returns:
            The answers that have come, oldest first; `owed` tells how many have not.

        Raises:
            ConnectionLost: the server went away, or its stall has filled the line and the memory set aside for it.
        """
        answers = self.collect(0.0)  # those that came meanwhile, or one stall would leave us behind for ever
        is_behind = self.owed > 0
        self._unsent += data
        self.owed += count
        return answers + self.collect(0.0 if is_behind else wait_s)

    def _send_unsent(self, timeout_s: float) -> None:
        try:
            self._wait(timeout_s)
            while self._unsent:
                del self._unsent[: self._socket.send(self._unsent)]
        except (TimeoutError, BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            if len(self._unsent) > _MOST_UNSENT:
                self.close()
                raise ConnectionLost(
                    f"bus {self.address}: it takes nothing any more, {_MOST_UNSENT} bytes wait"
                ) from None
        except OSError as error:
            self.close()
            raise ConnectionLost(f"bus {self.address}: {_reason(error)}") from error

    def collect(self, timeout_s: float) -> list[Any]:
        """Return the owed answers that come within a time, oldest first; 0 takes what is here."""
        answers: list[Any] = []
        if self._unsent:
            self._send_unsent(timeout_s)
        if not self.owed:
            return answers
        try:
            self._wait(timeout_s)
            while self.owed:
                answers.append(self._next())
                self.owed -= 1
        except (TimeoutError, BlockingIOError, ssl.SSLWantReadError):
            pass  # the rest is late; the caller sees it in `owed`
        except OSError as error:
            self.close()
            raise ConnectionLost(f"bus {self.address}: {_reason(error)}") from error
        return answers

    def send(self, *arguments: Argument) -> None:
        """Send a request without waiting for its answer (a subscription)."""
        try:
            self._wait(self._timeout_s)
            self._socket.sendall(pack(*arguments))
        except OSError as error:
            self.close()
            raise ConnectionLost(f"bus {self.address}: {_reason(error)}") from error

    def receive(self, timeout_s: float | None) -> Any:
        """Return the next message that the server pushes.

        Raises:
            TimeoutError: none came in time; the connection stays usable.
            ConnectionLost: the server went away.
        """
        try:
            self._wait(timeout_s)
            return self._next()
        except TimeoutError:
            raise
        except OSError as error:
            self.close()
            raise ConnectionLost(f"bus {self.address}: {_reason(error)}") from error

    def buffered(self) -> Any:
        """Return the next message that is already here, or ``False`` when there is none."""
        return self._reader.gets()

    def poll(self) -> Any:
        """Return the next message that has come by now, or ``False``; part of one is kept for a later call.

        Raises:
            ConnectionLost: the server went away.
        """
        if (message := self._reader.gets()) is not False:
            return message
        try:
            self._wait(0.0)
            self._feed()
        except (BlockingIOError, ssl.SSLWantReadError):
            return False
        except OSError as error:
            self.close()
            raise ConnectionLost(f"bus {self.address}: {_reason(error)}") from error
        return self._reader.gets()

    def set_timeout(self, timeout_s: float) -> None:
        """Set the longest wait for each answer [s]."""
        self._timeout_s = timeout_s

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._socket.fileno()

    def detach(self) -> socket.socket:
        """Hand the greeted socket over to another protocol (the replication link); this object is then closed.

        Every answer must have been taken: what is buffered here would be missing there.
        """
        if self._reader.has_data():
            raise BusError(f"bus {self.address}: an answer was not taken")
        self._wait(self._timeout_s)
        stream, self._socket = self._socket, socket.socket()
        self._socket.close()
        return stream

    def hang_up(self) -> None:
        """End the conversation, from any thread: one that waits in `receive` finds the connection lost at once."""
        with contextlib.suppress(OSError):  # it is gone already
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection; a second call does nothing."""
        self._socket.close()

    def _next(self) -> Any:
        try:
            while (reply := self._reader.gets()) is False:
                self._feed()
        except hiredis.ProtocolError as error:
            self.close()
            raise ConnectionLost(
                f"bus {self.address}: what answers there is no Redis server ({error}); --bus URL names another"
            ) from None
        return reply

    def _feed(self) -> None:
        data = self._socket.recv(_READ_SIZE)
        if not data:
            raise ConnectionResetError("the server closed the connection")
        self._reader.feed(data)

    def _wait(self, timeout_s: float | None) -> None:
        """Have the socket wait so long for what follows; the kernel is asked only where that is another time."""
        if timeout_s != self._waits_s:
            self._socket.settimeout(timeout_s)
            self._waits_s = timeout_s

    def _open(self) -> socket.socket:
        address = self.address
        try:
            stream = address.open(self._timeout_s if address.is_local else max(self._timeout_s, _FAR_OPEN_S))
            stream.settimeout(self._timeout_s)
            return stream
        except OSError as error:
            raise ConnectionLost(
                f"bus {address}: {_reason(error)}; does a station run there? `station up RUNBOOK` starts one, "
                "--bus URL names another"
            ) from error

    def _greet(self) -> None:
        address = self.address
        if address.password is not None:
            login = (address.username, address.password) if address.username else (address.password,)
            _checked_login(self.send_packed(pack("AUTH", *login))[0], address)
        reply = self.send_packed(pack("SELECT", address.db))[0]
        _checked_login(reply, address)


def _checked(reply: Any) -> Any:
    if isinstance(reply, hiredis.ReplyError):
        raise BusError(f"the bus answered: {reply}")
    return reply


def _checked_login(reply: Any, address: BusAddress) -> None:
    if not isinstance(reply, hiredis.ReplyError):
        return
    text = str(reply)
    if text.startswith(("NOAUTH", "WRONGPASS", "ERR AUTH", "ERR invalid password", "NOPERM")):
        raise BusError(
            f"bus {address}: the server asks for a password or refused ours ({text.split(' ', 1)[0]}); "
            "put it into $STATION_BUS_PASSWORD, or name a file that has it in $STATION_BUS_PASSWORD_FILE"
        )
    raise BusError(f"bus {address}: {text}")


def _reason(error: OSError) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return error.strerror or str(error)
