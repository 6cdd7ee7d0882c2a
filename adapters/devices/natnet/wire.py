"""NatNet's messages, 3.0, 3.1, 4.0 and 4.1: little-endian, an id and a length of 16 bits each, then the content.

A frame has sections one after another, each a count and its elements: marker sets, other markers, rigid bodies,
skeletons, assets (from 4.1), labelled markers, force plates, devices; then time codes and stamps. From 4.1 the length
of a section in bytes stands behind its count. Of all that skeletons and time are taken; the rest is passed over.

Facts of the layout: mje-nz/python_natnet, ``src/natnet/protocol/``; TimSchneider42/python-natnet-client,
``natnet/data_frame.py``, ``data_descriptions.py``, ``server_info.py``; OptiTrack's own samples ``NatNetClient.py`` and
``PacketClient.cpp`` (that 4.1 has two more numbers before a frame's flags).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

CONNECT, SERVER_INFO, REQUEST_DESCRIPTIONS, DESCRIPTIONS, FRAME, KEEP_ALIVE = 0, 1, 4, 5, 7, 10
"""Ids of messages."""

COMMAND_PORT, DATA_PORT, GROUP = 1510, 1511, "239.255.42.99"
"""Where Motive listens, and where it sends to by multicast, until its settings say otherwise."""

Version = tuple[int, int]
VERSIONS: tuple[Version, ...] = ((3, 0), (3, 1), (4, 0), (4, 1))
"""Those that are understood."""

BONE = np.dtype([("id", "<i4"), ("position", "<f4", 3), ("quat_xyzw", "<f4", 4), ("error", "<f4"), ("flags", "<i2")])
"""A bone in a frame: place [m] and orientation in Motive's world, its markers' mean error [m]; 1 in flags: tracked."""

TRACKED = 1
CHANGED = 2
"""In the flags of a frame: other skeletons than were described."""

HEADER = struct.Struct("<HH")
SERVER = struct.Struct("<256s4B4BQ")
STAMPS = struct.Struct("<IIdQQQ")
_MARKER, _LABELLED, _FLOAT = 12, 26, 4
_MOST_NAME = 256
_MARKER_SET, _RIGID_BODY, _SKELETON, _FORCE_PLATE, _DEVICE, _CAMERA = range(6)


class BadPacket(ValueError):
    """Bytes that are no message of the version, in a line."""


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """What a server says of itself.

    Attributes:
        application: Its name and version.
        version: Of NatNet.
        ticks_hz: Of its clock [1/s].
    """

    application: str
    version: Version
    ticks_hz: int


@dataclass(frozen=True, slots=True)
class Bone:
    """A bone of a skeleton as it is described.

    Attributes:
        name: With the skeleton's in front, as Motive has it.
        id: Within the skeleton.
        parent: Id of its parent; 0 for none.
        offset: From its parent, as the person stands with arms out, (3,) [m].
    """

    name: str
    id: int
    parent: int
    offset: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Skeleton:
    """A person as described: name, id, and bones."""

    name: str
    id: int
    bones: tuple[Bone, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What was seen at a time.

    Attributes:
        number: Of the frame.
        skeletons: Bones by the skeleton's id, each of dtype `BONE`.
        time_s: Since Motive or its take began [s].
        exposed: When the cameras' shutters were half through, in ticks of the server's clock; 0 where unknown.
        changed: Whether there are other skeletons than were described.
    """

    number: int
    skeletons: dict[int, NDArray[np.void]]
    time_s: float
    exposed: int
    changed: bool


def request(message: int) -> bytes:
    """Return a message from a client to a server."""
    content = b"Ping\0" if message == CONNECT else b""
    return HEADER.pack(message, len(content)) + content


def opened(data: bytes) -> tuple[int, bytes]:
    """Return a message's id and content.

    Raises:
        BadPacket: shorter than it says.
    """
    cursor = _Cursor(data)
    message, length = cursor.unpack(HEADER)
    return message, cursor.take(length)


def server_info(content: bytes) -> ServerInfo:
    """Return what a server says of itself; of a version before 3.0 as well, which lacks a clock.

    Raises:
        BadPacket: it is cut.
    """
    content = content.ljust(SERVER.size, b"\0") if len(content) >= SERVER.size - 8 else content
    name, *numbers, ticks_hz = _Cursor(content).unpack(SERVER)
    application = f"{_printable(name.split(bytes(1))[0])} {numbers[0]}.{numbers[1]}"
    return ServerInfo(application, (numbers[4], numbers[5]), ticks_hz)


def descriptions(content: bytes, version: Version) -> tuple[Skeleton, ...]:
    """Return the skeletons that a server describes.

    Raises:
        BadPacket: cut, a count beyond what came, or a kind of description that the version does not have.
    """
    cursor, found = _Cursor(content), []
    for _ in range(cursor.count(4)):
        kind = cursor.integer()
        part = _Cursor(cursor.take(cursor.integer())) if version >= (4, 1) else cursor
        if kind == _SKELETON:
            found.append(_skeleton(part, version))
        elif version < (4, 1):
            _pass_description(part, kind, version)
    return tuple(found)


def frame(content: bytes, version: Version) -> Frame:
    """Return what was seen.

    Raises:
        BadPacket: cut, a count beyond what came, or a place, orientation or time that is not finite.
    """
    cursor, has_lengths = _Cursor(content), version >= (4, 1)
    number = cursor.integer()
    if has_lengths:
        for _ in range(3):
            _pass_section(cursor)
        count, length = cursor.integer(), cursor.integer()
        found = _bones(_Cursor(cursor.take(length)), count)
        for _ in range(4):
            _pass_section(cursor)
    else:
        for _ in range(cursor.count(5)):
            cursor.text()
            cursor.pass_many(_MARKER)
        cursor.pass_many(_MARKER)
        cursor.pass_many(BONE.itemsize)
        found = _bones(cursor, cursor.integer())
        cursor.pass_many(_LABELLED)
        for _ in range(2):
            _pass_channels(cursor)
    _, _, time_s, exposed, _, _ = cursor.unpack(STAMPS)
    if not 0.0 <= time_s < 1e9:
        raise BadPacket(f"frame {number} is of {time_s:g} s; expected a time from its start")
    if has_lengths:
        cursor.take(8)
    return Frame(number, found, time_s, exposed, bool(cursor.short() & CHANGED))


class _Cursor:
    """Reads on from where it was; nothing beyond the end is read, and nothing is made that did not come."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, length: int) -> bytes:
        left = len(self._data) - self._at
        if not 0 <= length <= left:
            raise BadPacket(f"{length} bytes announced where {left} are left")
        self._at += length
        return self._data[self._at - length : self._at]

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        return layout.unpack(self.take(layout.size))

    def integer(self) -> int:
        return int.from_bytes(self.take(4), "little", signed=True)

    def short(self) -> int:
        return int.from_bytes(self.take(2), "little")

    def count(self, least: int) -> int:
        """Return a count of elements that are that long at least [bytes]."""
        count, left = self.integer(), len(self._data) - self._at
        if not 0 <= count * least <= left:
            raise BadPacket(f"{count} elements announced where {left} bytes are left")
        return count

    def pass_many(self, each: int) -> None:
        """Pass over elements of a length behind their count [bytes]."""
        self.take(self.count(each) * each)

    def text(self) -> str:
        end = self._data.find(b"\0", self._at, self._at + _MOST_NAME)
        if end < 0:
            raise BadPacket(f"a name of more than {_MOST_NAME} bytes")
        return _printable(self.take(end + 1 - self._at)[:-1])


def _printable(name: bytes) -> str:
    text = name.decode("utf-8", "replace")
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _bones(cursor: _Cursor, count: int) -> dict[int, NDArray[np.void]]:
    found = {}
    for _ in range(count):  # a count beyond what came ends at the first that is not there
        skeleton, bones = cursor.integer(), cursor.count(BONE.itemsize)
        rows = np.frombuffer(cursor.take(bones * BONE.itemsize), BONE)
        if not (np.isfinite(rows["position"]).all() and np.isfinite(rows["quat_xyzw"]).all()):
            raise BadPacket(f"a bone of skeleton {skeleton} is not finite")
        found[skeleton] = rows
    return found


def _pass_section(cursor: _Cursor) -> None:
    cursor.integer()
    cursor.take(cursor.integer())


def _pass_channels(cursor: _Cursor) -> None:
    """Pass over force plates or devices: each an id, and channels of numbers."""
    for _ in range(cursor.count(8)):
        cursor.integer()
        for _ in range(cursor.count(4)):
            cursor.pass_many(_FLOAT)


def _skeleton(cursor: _Cursor, version: Version) -> Skeleton:
    name, id_ = cursor.text(), cursor.integer()
    return Skeleton(name, id_, tuple(_bone(cursor, version) for _ in range(cursor.count(25))))


_BONE = struct.Struct("<ii3f")


def _bone(cursor: _Cursor, version: Version) -> Bone:
    name = cursor.text()
    id_, parent, *offset = cursor.unpack(_BONE)
    if not np.isfinite(offset).all():
        raise BadPacket(f"bone {name} has an offset that is not finite")
    markers = cursor.count(_MARKER + 4)
    cursor.take(markers * (_MARKER + 4))
    if version >= (4, 0):
        for _ in range(markers):
            cursor.text()
    return Bone(name, id_, parent, (offset[0], offset[1], offset[2]))


def _pass_description(cursor: _Cursor, kind: int, version: Version) -> None:
    if kind == _MARKER_SET:
        cursor.text()
        _pass_texts(cursor)
    elif kind == _RIGID_BODY:
        _bone(cursor, version)
    elif kind == _FORCE_PLATE:
        cursor.integer()
        cursor.text()
        cursor.take(4 * (2 + 3 + 12 * 12 + 4 * 3 + 2))  # sizes, origin, calibration, corners, two types
        _pass_texts(cursor)
    elif kind == _DEVICE:
        cursor.integer()
        cursor.text()
        cursor.text()
        cursor.take(8)
        _pass_texts(cursor)
    elif kind == _CAMERA:
        cursor.text()
        cursor.take(4 * 7)
    else:
        raise BadPacket(f"a description of kind {kind}; NatNet {version[0]}.{version[1]} has 0 to {_CAMERA}")


def _pass_texts(cursor: _Cursor) -> None:
    for _ in range(cursor.count(1)):
        cursor.text()
