"""Serial lines in memory, in the place of pyserial's: a glove's thread and what it reads share one virtual time."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from station.clock import Clock

_NAP_S = 0.002
NAME = "usb-1a86_USB_Single_Serial_{}-if00"


class Line:
    """What is behind a port: what is sent arrives at once."""

    def __init__(self, clock: Clock, folder: Path, serial: str) -> None:
        self.clock, self.path = clock, folder / NAME.format(serial)
        self.waiting, self.is_plugged, self.users = b"", True, 0
        self.path.touch()

    def send(self, data: bytes) -> None:
        if self.users:
            self.waiting += data

    def unplug(self) -> None:
        self.is_plugged = False


class _Opened:
    """An open port, as pyserial gives it."""

    def __init__(self, line: Line, timeout: float) -> None:
        line.users += 1
        self._line, self._timeout_s, self._is_open = line, timeout, True

    @property
    def in_waiting(self) -> int:
        self._expect_plugged()
        return len(self._line.waiting)

    def read(self, length: int) -> bytes:
        end_s = self._line.clock.monotonic_s() + self._timeout_s
        while not self._line.waiting and self._line.clock.monotonic_s() < end_s:
            self._line.clock.sleep(_NAP_S)
            self._expect_plugged()
        found, self._line.waiting = self._line.waiting[:length], self._line.waiting[length:]
        return found

    def reset_input_buffer(self) -> None:
        self._expect_plugged()
        self._line.waiting = b""

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            self._line.users -= 1

    def _expect_plugged(self) -> None:
        if not self._line.is_plugged:
            raise OSError(errno.EIO, os.strerror(errno.EIO))


@contextmanager
def lines_in_memory() -> Iterator[dict[str, Line]]:
    """Give pyserial lines in memory; yields those that can be opened, by the names of their ports."""
    lines: dict[str, Line] = {}

    def opened(port: str, *, baudrate: int, timeout: float, exclusive: bool) -> Any:
        line = lines.get(port)
        if line is None or not line.is_plugged:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), port)
        if line.users and exclusive:
            raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN), port)
        return _Opened(line, timeout)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("serial.Serial", opened)
        yield lines
