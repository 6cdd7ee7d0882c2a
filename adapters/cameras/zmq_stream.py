"""The picture stream that TWIST2's vision client hears: ZeroMQ, one message per picture.

A message is three 32-bit integers in the sender's byte order (width, height, length) and a JPEG file of that length.
It carries neither a time nor a number, so a picture counts as taken when it arrives, and what the sender or the network
dropped before cannot be known.
"""

from __future__ import annotations

import struct
import time
from importlib import metadata
from typing import Any

from adapters.cameras.encode import library
from station import jpeg
from station.camera.source import CameraError, Drops, Picture, PictureSettings

_HEAD = struct.Struct("=iii")
_MOST_BYTES = 16 << 20  # a stranger's message that is longer ends the connection
_BACKLOG = 8  # messages that wait here; more stay with the sender, which then drops its own


class ZmqCamera:
    """Hears a stream; implements `station.camera.source.Camera`. It comes and goes by itself: ZeroMQ reconnects.

    Args:
        address: Where the sender is, such as ``tcp://192.168.123.164:5555``.
        settings: Size and rate are the sender's; another wish is refused.

    Raises:
        CameraError: no pyzmq, no such address, or a wish that cannot be met.
    """

    def __init__(self, address: str, settings: PictureSettings) -> None:
        self.drops = Drops()
        self._address = address
        self._zmq = library("zmq", "pyzmq", "the source zmq")
        self._why_not = ""
        self._size: tuple[int, int] | None = None
        self._socket: Any = None
        if (settings.width, settings.height, settings.fps) != (None, None, None):
            raise CameraError(f"{address}: the sender decides on size and rate; leave out width, height and fps")
        self._connect()
        self._disconnect()  # an address that cannot be is found out now; pictures are wanted later

    def read(self, timeout_s: float) -> Picture | None:
        """Return the newest picture that has arrived; see `Camera.read`."""
        if self._socket is None:
            self._connect()
        if not self._socket.poll(round(timeout_s * 1e3)):
            return None
        messages = []
        for _ in range(_BACKLOG):
            try:
                messages.append(self._socket.recv_multipart(self._zmq.NOBLOCK))
            except self._zmq.Again:
                break
        return self._newest(messages)

    def why_silent(self) -> str:
        """Return what is wrong with what comes, or where nothing comes from."""
        return self._why_not or f"{self._address}: nothing comes; does the sender run, and is its port open?"

    def facts(self) -> dict[str, Any]:
        """Return the address, and how little the stream tells."""
        return {
            "width": self._size[0] if self._size else None,
            "height": self._size[1] if self._size else None,
            "fps": None,
            "format": "JPEG",
            "is_passed_through": True,
            "device": self._address,
            "capture": "arrival: the stream carries no time, so transport is not in it",
            "exposure": None,
            "library": f"pyzmq {metadata.version('pyzmq')}",
        }

    def close(self) -> None:
        """Hang up."""
        self._disconnect()

    def _connect(self) -> None:
        zmq = self._zmq
        self._socket = zmq.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVHWM, _BACKLOG)
        self._socket.setsockopt(zmq.MAXMSGSIZE, _MOST_BYTES)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"")
        try:
            self._socket.connect(self._address)
        except zmq.ZMQError as error:
            self._disconnect()
            raise CameraError(
                f"{self._address}: {error.strerror or error}; expected an address such as tcp://192.168.123.164:5555"
            ) from None

    def _disconnect(self) -> None:
        held, self._socket = self._socket, None
        if held is not None:
            held.close()

    def _newest(self, messages: list[list[bytes]]) -> Picture | None:
        now_ns, picture = time.monotonic_ns(), None
        for parts in reversed(messages):
            if picture is not None:
                self.drops.skipped += 1
                continue
            data, known, why_not = _file(b"".join(parts))
            self._why_not = why_not and f"{self._address}: {why_not}"
            if known is None:
                self.drops.torn += 1
            else:
                self._size = known.width, known.height
                picture = Picture(jpeg.readable(data, known), now_ns)
        return picture


def _file(message: bytes) -> tuple[bytes, jpeg.Head | None, str]:
    """Return the file in a message and its head, or None for that and what is wrong."""
    data = message[_HEAD.size :]
    if len(message) < _HEAD.size:
        return data, None, f"a message of {len(message)} bytes; expected width, height, length and a JPEG file"
    _, _, length = _HEAD.unpack_from(message)
    if length != len(data):
        return data, None, f"a message says {length} bytes and has {len(data)}; is the sender one of TWIST2's?"
    known = jpeg.head(data)
    return data, known, "" if known else "a message holds no whole JPEG file; is the sender one of TWIST2's?"
