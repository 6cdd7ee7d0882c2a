"""Pictures of a camera of the station as the ZeroMQ stream of TWIST2's robot, for its stock client and recorder.

A message is three 32-bit integers in this computer's byte order (width, height, length) and the camera's JPEG file,
byte for byte; the client drops one of another length, and hears no time and no number. So it is told here how old
pictures were when they were sent, and which were not. The way in is the camera source ``zmq``.
"""

from __future__ import annotations

import os
import re
import struct
from collections import Counter

import msgspec

from adapters import zeromq
from station import jpeg, libraries
from station.bus import keys
from station.bus.address import is_loopback
from station.bus.sample import Sample
from station.config import to_plain
from station.life.server import Life, ServerKind

ADDRESS = "tcp://127.0.0.1:5555"
"""Where TWIST2's programs look for the stream, on the robot's address."""

SILENT_S = 1.0
"""A camera without a picture for so long is silent [s]."""

_HEAD = struct.Struct("=iii")
_LOOK_S = 0.1
_QUEUED, _KERNEL_BYTES = 2, 1 << 18  # pictures that wait for who does not read; the kernel's for a few more
_MOST_SKIPPED = 1_000_000  # at once; a stamp that says more is no camera's count
_NAME = re.compile(r"[a-z0-9_]+")


class PictureStreamConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the picture stream.

    Attributes:
        camera: Name of the camera, as in ``camera_image_NAME``.
        address: Where it listens; TWIST2's programs connect to port 5555 of the robot's address.
        niceness: How far the process stands back behind others, 0 to 19: pictures may wait, a robot may not.
    """

    camera: str = "head"
    address: str = ADDRESS
    niceness: int = 5

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.camera):
            raise ValueError(f"camera is {self.camera!r}; expected small letters, digits and _, for example head")
        zeromq.expect_address("address", self.address, listens=True)
        if not 0 <= self.niceness <= 19:
            raise ValueError(f"niceness is {self.niceness}; expected 0 to 19")


def main(config: PictureStreamConfig, life: Life) -> int:
    """Publish pictures until asked to stop; return the exit code."""
    os.nice(config.niceness)
    key = keys.camera_image(config.camera)
    socket = zeromq.Publisher(config.address, queued=_QUEUED, kernel_bytes=_KERNEL_BYTES)
    try:
        life.configured({"server": life.name, "role": KIND.role, "key": key, "config": to_plain(config)})
        if not life.ready():
            return 0
        if not is_loopback(zeromq.host_of(config.address)):
            note = "everybody who reaches it sees the pictures"
            life.event("picture-stream-open-to-network", severity="warning", address=config.address, note=note)
        PictureStream(life, socket, key).run()
    finally:
        socket.close()
    return 0


KIND = ServerKind(
    name="picture-stream",
    role="observer",
    summary="a camera's pictures as TWIST2's ZeroMQ stream",
    config=PictureStreamConfig,
    main=main,
    expect=lambda config: libraries.expect("the picture stream", "pyzmq", zeromq.EXTRA),
)


class PictureStream:
    """The loop: wait for a picture, send it, tell.

    Args:
        life: The server's.
        socket: Where it is heard.
        key: Of the camera's pictures.
    """

    def __init__(self, life: Life, socket: zeromq.Publisher, key: str) -> None:
        self._life, self._socket, self._key = life, socket, key
        self._sent, self._dropped = 0, Counter[str]()
        self._age_s: float | None = None
        self._is_live = self._is_heard = False

    def run(self) -> None:
        """Send until asked to stop."""
        last: Sample | None = None
        with self._life.bus.watch([self._key]) as watch:
            while not self._life.stopping:
                found = watch.wait(self._key, after=last, timeout_s=_LOOK_S)
                self._socket.poll()
                if found is not None:
                    self._count_skipped(last, found)
                    last = found
                    self._send(found)
                self._tell(last)

    def _send(self, picture: Sample) -> None:
        known = jpeg.head(picture.value)
        if known is None:
            self._dropped["no JPEG file"] += 1
            return
        head = _HEAD.pack(known.width, known.height, len(picture.value))
        if why_not := self._socket.send(head + picture.value):
            self._dropped[why_not] += 1
            return
        self._sent += 1
        taken_ns = picture.written_ns or picture.arrived_ns
        if picture.stamp is not None and picture.stamp.is_from_this_boot:
            taken_ns = picture.stamp.capture_ns or taken_ns
        self._age_s = None if taken_ns is None else (self._life.clock.monotonic_ns() - taken_ns) * 1e-9

    def _count_skipped(self, last: Sample | None, found: Sample) -> None:
        """Count pictures that were overwritten before they were read, as far as their numbers say so."""
        if last is None or last.stamp is None or found.stamp is None or last.stamp.source != found.stamp.source:
            return
        missing = found.stamp.seq - last.stamp.seq - 1
        if 0 < missing < _MOST_SKIPPED:
            self._dropped["overwritten"] += missing

    def _tell(self, last: Sample | None) -> None:
        age_s = None if last is None else last.age_s(self._life.clock.monotonic_ns())
        if (is_live := age_s is not None and age_s < SILENT_S) != self._is_live:
            self._is_live = is_live
            name = "picture-stream-live" if is_live else "picture-stream-silent"
            self._life.event(name, severity="info" if is_live else "warning", key=self._key, sent=self._sent)
        if (is_heard := self._socket.is_wanted(b"")) != self._is_heard:
            self._is_heard = is_heard
            self._life.event("picture-stream-heard" if is_heard else "picture-stream-not-heard", key=self._key)
        self._life.report(
            sent=self._sent, dropped=dict(self._dropped), live=is_live, heard=is_heard,
            age_ms=None if self._age_s is None else round(self._age_s * 1e3, 1),
        )  # fmt: skip
