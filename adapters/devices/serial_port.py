"""What devices on serial ports share: the adapter's number, why a port cannot be used, a thread that reads it."""

from __future__ import annotations

import errno
import os
import re
import threading
from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple

from station.clock import Clock
from station.operator.device import DeviceError
from station.protocols import Floats

BY_ID = Path("/dev/serial/by-id")

_STOP_S = 5.0
_SERIAL = re.compile(r"_([A-Za-z0-9-]+)-if\d+(-port\d+)?$")


class PortGone(DeviceError):
    """The serial port was torn out."""


class Reading(NamedTuple):
    """What a device showed.

    Attributes:
        capture_ns: When, on this machine's monotonic clock [ns].
        values: Joints [rad], parts of a way from 0 to 1, shape (n,).
    """

    capture_ns: int
    values: Floats


class PortReader(ABC):
    """A thread that reads a serial port, which is its own until `close`; it begins with `start`.

    Args:
        clock: Of the process.

    Attributes:
        newest: The newest reading; None before the first.
        fault: Why there will be no further one; "" while there will.
    """

    def __init__(self, clock: Clock) -> None:
        self.newest: Reading | None = None
        self.fault = ""
        self._clock, self._stop = clock, threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, name: str) -> None:
        """Start the thread, under a name."""
        self._thread = self._clock.start(self._run, name)

    def close(self) -> None:
        """End the thread and release the port; a second call does nothing."""
        self._stop.set()
        if self._thread is not None:
            self._clock.join(self._thread, _STOP_S)
        self._release()

    def _run(self) -> None:
        try:
            self._read_until_stopped()
        except PortGone as error:
            self.fault = str(error)

    @abstractmethod
    def _read_until_stopped(self) -> None:
        """Set `newest` again and again, until `_stop` is set or there is a `fault`; may raise `PortGone`."""

    @abstractmethod
    def _release(self) -> None:
        """Close the port."""


def serial_of(port: str, folder: Path = BY_ID) -> str:
    """Return the serial number of a port's adapter: from its name, or from the name by id of the same device.

    For an adapter without one it is the last part of the port's name: ``ttyUSB0``.
    """
    names = [
        port,
        *(str(path) for path in sorted(folder.glob("*")) if os.path.realpath(path) == os.path.realpath(port)),
    ]
    for name in names:
        match = _SERIAL.search(os.path.basename(name))
        if match:
            return match[1]
    return os.path.basename(port)


def why_not_open(port: str, error: OSError, *, device: str, setting: str) -> str:
    """Return in one line why a port cannot be opened, and what to do.

    Args:
        port: Its name.
        error: What opening it raised.
        device: What is to be plugged in, as a person says it.
        setting: The setting that names another port.
    """
    number = error.errno
    if number == errno.ENOENT:
        return f"{port}: no such port; plug the {device} in, or name another with {setting}:"
    if number in (errno.EACCES, errno.EPERM):
        return f"{port}: permission denied; join the group of the port and log in anew: sudo usermod -aG dialout $USER"
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return f"{port}: in use by another process; stop it first (`fuser {os.path.realpath(port)}` tells which)"
    return f"{port}: cannot be opened: {error}"


def why_gone(port: str, error: Exception, *, device: str) -> str:
    """Return in one line that a port was torn out, as the error of a read or a write says."""
    said = str(error.args[-1] if error.args else error).splitlines()[0]
    return f"{port}: gone ({said}); plug the {device} in again"
