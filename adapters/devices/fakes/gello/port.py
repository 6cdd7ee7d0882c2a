"""A serial port with servos behind it: a pseudo terminal that answers as the bus does."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path

from adapters.devices.fakes.gello.servos import Chain
from adapters.devices.fakes.pty_port import PtyPort
from adapters.devices.fakes.punctual import be_punctual
from adapters.devices.gello.bus import Servos

LINKS: dict[Servos, str] = {
    "dynamixel": "usb-FTDI_USB__-__Serial_Converter_{serial}-if00-port0",
    "feetech": "usb-1a86_USB_Single_Serial_{serial}-if00",
}
"""Names of the adapters as udev gives them."""

RATES: dict[Servos, int] = {"dynamixel": termios.B57600, "feetech": termios.B1000000}
"""The usual rates, as constants of `termios`."""

_LOOK_S = 0.02
_CHUNK = 4096
_OSPEED = 5  # place in what termios returns


class FakePort(PtyPort):
    """An adapter with a chain of servos, under a name as udev gives it.

    Args:
        folder: Where the name appears, in place of ``/dev/serial/by-id``.
        serial: Serial number of the adapter.
        chain: The servos.
        baud: The rate they listen at; at another one there is only noise. A constant of `termios`; None for their
            maker's usual one.
        before_reply: Called before each answer, to bring the servos up to date.

    Attributes:
        path: The name of the port.
        delay_s: How long every answer takes [s].
    """

    def __init__(
        self,
        folder: Path,
        serial: str,
        chain: Chain,
        *,
        baud: int | None = None,
        before_reply: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(folder / LINKS[chain.maker].format(serial=serial))
        self.delay_s = 0.0
        self._chain, self._before_reply = chain, before_reply
        self._baud = RATES[chain.maker] if baud is None else baud
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"fake-{serial}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and take the port away."""
        self._stop.set()
        self._thread.join()
        self.unplug()

    def _serve(self) -> None:
        be_punctual()  # the library waits 34 ms for an answer
        wire = self._chain.wire()
        while not self._stop.is_set():
            self._before_reply()
            data, speed = self._receive()
            for packet in wire.feed(data) if speed == self._baud else ():
                self._before_reply()
                if self.delay_s:
                    time.sleep(self.delay_s)
                self._send(self._chain.reply(packet))

    def _receive(self) -> tuple[bytes, int]:
        with self._lock:  # so that nobody closes it, and opens something else of its number, meanwhile
            is_there = self._master >= 0
            if is_there and select.select([self._master], [], [], _LOOK_S)[0]:
                return os.read(self._master, _CHUNK), termios.tcgetattr(self._master)[_OSPEED]
        self._stop.wait(0.0 if is_there else _LOOK_S)
        return b"", 0

    def _send(self, data: bytes) -> None:
        with self._lock, contextlib.suppress(OSError):
            if data and self._master >= 0:
                os.write(self._master, data)
