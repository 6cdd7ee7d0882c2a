"""LCM's datagrams: a message of up to 64 kB in one, a longer one in fragments. Pure; its time is given.

::

    short     "LC02", number u32, channel, 0, message
    fragment  "LC03", number u32, size of the message u32, offset u32, fragment u16, of so many u16;
              in the first one channel and 0; a piece of the message

All integers are big-endian; `number` counts the messages of a sender. Facts: lcm-proj/lcm, its page on the protocol of
UDP multicast and ``lcm/udpm_util.h``.
"""

from __future__ import annotations

import struct
from collections.abc import Hashable
from dataclasses import dataclass, field

SHORT, FRAGMENT = 0x4C433032, 0x4C433033
LONGEST_CHANNEL = 63
"""Of a channel's name [bytes]."""

MOST_BYTES = 1 << 20
"""Of a message that comes in fragments; HOMIE's longest has 480 bytes."""

MOST_SENDERS = 8
"""That may have sent a part of a message; each sends one message after another."""

FORGET_S = 1.0
"""A message whose fragments do not come within this is given up [s]."""

_SHORT = struct.Struct(">II")
_FRAGMENT = struct.Struct(">IIIIHH")
_MOST_SHORT = 65499  # channel, 0 and message of LCM's longest short datagram
_PIECE = 60_000
_MOST_PIECES = 64  # LCM's own library sends pieces of 64 kB


class BadPacket(ValueError):
    """A datagram that is none of LCM's."""


def datagrams(number: int, channel: str, message: bytes) -> list[bytes]:
    """Return what is sent for a message.

    Args:
        number: Of the message among those of its sender; its lowest 32 bits count.
        channel: Name of the channel.
        message: Its bytes, `MOST_BYTES` at most.

    Raises:
        ValueError: a channel or a message that is too long.
    """
    name = channel.encode("ascii")
    if not 0 < len(name) <= LONGEST_CHANNEL or len(message) > MOST_BYTES:
        raise ValueError(
            f"{channel!r}: a message of {len(message)} bytes; expected at most {MOST_BYTES}, and {LONGEST_CHANNEL} of "
            "the channel's name"
        )
    number &= 0xFFFFFFFF
    if len(name) + 1 + len(message) <= _MOST_SHORT:
        return [_SHORT.pack(SHORT, number) + name + b"\0" + message]
    pieces = [message[start : start + _PIECE] for start in range(0, len(message), _PIECE)]
    return [
        _FRAGMENT.pack(FRAGMENT, number, len(message), index * _PIECE, index, len(pieces))
        + (name + b"\0" if index == 0 else b"")
        + piece
        for index, piece in enumerate(pieces)
    ]


@dataclass(slots=True)
class _Partial:
    number: int
    size: int
    count: int
    began_s: float
    channel: str = ""
    pieces: dict[int, tuple[int, bytes]] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether all fragments are there."""
        return len(self.pieces) == self.count

    def joined(self) -> bytes:
        """Return the message.

        Raises:
            BadPacket: the fragments do not fit together.
        """
        message = bytearray()
        for _, (offset, piece) in sorted(self.pieces.items()):
            if offset != len(message):
                raise BadPacket(f"a fragment at {offset}, expected at {len(message)}")
            message += piece
        if len(message) != self.size:
            raise BadPacket(f"fragments of {len(message)} bytes, expected {self.size}")
        return bytes(message)


class Assembler:
    """From datagrams to messages; of each sender one message at a time is put together."""

    def __init__(self) -> None:
        self._partials: dict[Hashable, _Partial] = {}

    def push(self, datagram: bytes, sender: Hashable, now_s: float) -> tuple[str, bytes] | None:
        """Return channel and message, where a datagram completes one.

        Args:
            datagram: It.
            sender: Whose it is.
            now_s: The instant [s].

        Raises:
            BadPacket: it is none of LCM's, or a fragment that does not fit those before it.
        """
        magic = int.from_bytes(datagram[:4], "big")
        if magic == SHORT and len(datagram) > _SHORT.size:
            return _named(datagram[_SHORT.size :])
        if magic == FRAGMENT and len(datagram) > _FRAGMENT.size:
            return self._add(datagram, sender, now_s)
        raise BadPacket(f"{len(datagram)} bytes that begin with {datagram[:4]!r}")

    def _add(self, datagram: bytes, sender: Hashable, now_s: float) -> tuple[str, bytes] | None:
        _, number, size, offset, index, count = _FRAGMENT.unpack_from(datagram)
        piece = datagram[_FRAGMENT.size :]
        if not 0 < count <= _MOST_PIECES or not 0 < size <= MOST_BYTES or index >= count:
            raise BadPacket(f"fragment {index} of {count}, of a message of {size} bytes")
        for other in [one for one, each in self._partials.items() if now_s - each.began_s > FORGET_S]:
            del self._partials[other]
        partial = self._partials.get(sender)
        if partial is None or (partial.number, partial.size, partial.count) != (number, size, count):
            self._partials.pop(sender, None)
            if len(self._partials) >= MOST_SENDERS:
                raise BadPacket(f"fragments of more than {MOST_SENDERS} senders at once")
            partial = self._partials[sender] = _Partial(number, size, count, now_s)
        if index == 0:
            partial.channel, piece = _named(piece)
        partial.pieces[index] = offset, piece
        if sum(len(each) for _, each in partial.pieces.values()) > size:
            del self._partials[sender]
            raise BadPacket(f"fragments of more than the {size} bytes that were announced")
        if not partial.is_whole:
            return None
        del self._partials[sender]
        return partial.channel, partial.joined()


def _named(data: bytes) -> tuple[str, bytes]:
    """Return a channel's name and what follows it."""
    name, end, rest = data.partition(b"\0")
    if not end or not 0 < len(name) <= LONGEST_CHANNEL or not name.isascii():
        raise BadPacket("a channel's name that is empty, too long, or not of ASCII")
    return name.decode("ascii"), rest
