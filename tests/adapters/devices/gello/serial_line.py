"""Serial lines in memory, in the place of pyserial's: the maker's library and the servos then share one virtual time.

What no program can do in less than its time is real on a pseudo terminal: `adapters.devices.fakes.gello.port`.
"""

from __future__ import annotations

import errno
import os
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.gello.port import _LOOK_S, LINKS, RATES
from adapters.devices.fakes.gello.servos import Chain
from station.clock import Clock

_BAUDS = {termios.B57600: 57_600, termios.B1000000: 1_000_000}
_NAP_S = 0.002  # what a read costs that finds nothing, as `adapters.devices.gello.bus` waits for bytes


class LinePort:
    """As `FakePort`, with a line in memory in place of a pseudo terminal."""

    def __init__(
        self, clock: Clock, ports: dict[str, LinePort], folder: Path, serial: str, chain: Chain, *,
        baud: int | None = None, before_reply: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self.path, self.clock = folder / LINKS[chain.maker].format(serial=serial), clock
        self.baud = _BAUDS[RATES[chain.maker] if baud is None else baud]
        self._ports, self._chain, self._before_reply = ports, chain, before_reply
        self._stop = threading.Event()
        self.plug()
        self._thread = clock.start(self._look, f"fake-{serial}")

    def plug(self) -> None:
        self._ports[str(self.path)] = self
        self.path.touch()

    def unplug(self) -> None:
        if self._ports.get(str(self.path)) is self:
            del self._ports[str(self.path)]
            self.path.unlink(missing_ok=True)

    def close(self) -> None:
        self._stop.set()
        self.clock.join(self._thread)
        self.unplug()

    def reply(self, data: bytes) -> bytes:
        """Return what the servos answer; each packet is written whole."""
        self._before_reply()
        return b"".join(self._chain.reply(packet) for packet in self._chain.wire().feed(data))

    def _look(self) -> None:
        while not self.clock.wait(self._stop, _LOOK_S):
            self._before_reply()


class _Line:
    """An open port, as the library sees it."""

    def __init__(self, ports: dict[str, LinePort], users: set[str], port: str, baudrate: int) -> None:
        if port not in ports:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), port)
        if port in users:
            raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN), port)
        self._ports, self._users, self._port, self._line, self._baud = ports, users, port, ports[port], baudrate
        self._received = b""
        self._ready = os.open(os.devnull, os.O_RDONLY)  # always readable: waiting is done in `read`
        users.add(port)

    def fileno(self) -> int:
        return self._ready

    @property
    def in_waiting(self) -> int:
        self._expect_plugged()
        return len(self._received)

    def read(self, length: int) -> bytes:
        self._expect_plugged()
        if length and not self._received:
            self._line.clock.sleep(_NAP_S)
        found, self._received = self._received[:length], self._received[length:]
        return found

    def write(self, data: Any) -> int:
        self._expect_plugged()
        if self._baud == self._line.baud:
            self._received += self._line.reply(bytes(data))
        return len(data)

    def reset_input_buffer(self) -> None:
        self._expect_plugged()
        self._received = b""

    def close(self) -> None:
        if self._port in self._users:
            self._users.discard(self._port)
            os.close(self._ready)

    def _expect_plugged(self) -> None:
        if self._ports.get(self._port) is not self._line:
            raise OSError(errno.EIO, os.strerror(errno.EIO))


@contextmanager
def lines_in_memory(clock: Clock) -> Iterator[Callable[..., LinePort]]:
    """Give the library lines in memory; yields what makes a port, and fakes make theirs by it."""
    ports: dict[str, LinePort] = {}
    users: set[str] = set()

    def port(folder: Path, serial: str, chain: Chain, **how: Any) -> LinePort:
        return LinePort(clock, ports, folder, serial, chain, **how)

    def line(port: str, baudrate: int, **_: Any) -> _Line:
        return _Line(ports, users, port, baudrate)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("serial.Serial", line)
        patch.setattr("adapters.devices.fakes.gello.leader.FakePort", port)
        yield port
