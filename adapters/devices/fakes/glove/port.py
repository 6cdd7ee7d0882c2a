"""A serial port with a microcontroller behind it that writes by itself, a hundred times a second."""

from __future__ import annotations

import contextlib
import os
import select
import threading
from collections.abc import Callable
from pathlib import Path

from adapters.devices.fakes.pty_port import PtyPort
from adapters.devices.fakes.punctual import be_punctual

PERIOD_S = 0.01

_LINK = "usb-1a86_USB_Single_Serial_{serial}-if00"


class FakePort(PtyPort):
    """The port, under a name as udev gives it.

    Args:
        folder: Where the name appears, in place of ``/dev/serial/by-id``.
        serial: Serial number of the adapter.
        next_bytes: Returns what is written next.
    """

    def __init__(self, folder: Path, serial: str, next_bytes: Callable[[], bytes]) -> None:
        super().__init__(folder / _LINK.format(serial=serial))
        self._next_bytes = next_bytes
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._write, name=f"fake-{serial}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop writing and take the port away."""
        self._stop.set()
        self._thread.join()
        self.unplug()

    def _write(self) -> None:
        be_punctual()
        while not self._stop.wait(PERIOD_S):
            self._send(self._next_bytes())

    def _send(self, data: bytes) -> None:
        """Write bytes; where nobody reads they are lost, as on a serial port."""
        with self._lock, contextlib.suppress(OSError):
            if data and self._master >= 0 and select.select([], [self._master], [], 0.0)[1]:
                os.write(self._master, data)
