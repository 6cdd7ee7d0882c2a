"""Dynamixel protocol 2.0 as a servo speaks it: instruction packets in, status packets out.

    FF FF FD 00, id, length (2 bytes, little-endian), instruction, parameters, CRC-16 (2 bytes)

The length counts what follows it. Within instruction and parameters ``FF FF FD`` is followed by one more ``FD``, so
that no packet holds the header of another.
"""

from __future__ import annotations

from typing import NamedTuple

BROADCAST = 0xFE
PING, READ, WRITE, REBOOT, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x08, 0x55, 0x82, 0x83

NO_ERROR, BAD_INSTRUCTION, BAD_CRC, BAD_LENGTH, NO_ACCESS = 0, 2, 3, 5, 7

_HEADER = b"\xff\xff\xfd\x00"
_STUFFED, _PLAIN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"
_FRONT = 7  # header, id and length
_POLYNOMIAL = 0x8005
_LONGEST = 1024


class Packet(NamedTuple):
    """An instruction, or None for one that came with a wrong CRC."""

    id: int
    instruction: int | None
    parameters: bytes


def crc16(data: bytes) -> int:
    """Return the CRC of a packet: polynomial 0x8005, from 0, highest bit first."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ _POLYNOMIAL if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def packet(id_: int, instruction: int, parameters: bytes) -> bytes:
    """Return a packet as it goes over the wire."""
    body = (bytes([instruction]) + parameters).replace(_PLAIN, _STUFFED)
    front = _HEADER + bytes([id_]) + (len(body) + 2).to_bytes(2, "little") + body
    return front + crc16(front).to_bytes(2, "little")


def status(id_: int, error: int, data: bytes = b"") -> bytes:
    """Return the answer of a servo."""
    return packet(id_, STATUS, bytes([error]) + data)


class Wire:
    """Finds packets in the bytes that arrive."""

    def __init__(self) -> None:
        self._waiting = b""

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete by now; noise between them is dropped."""
        self._waiting += data
        found = []
        while (one := self._next()) is not None:
            found.append(one)
        return found

    def _next(self) -> Packet | None:
        start = self._waiting.find(_HEADER)
        if start < 0:
            self._waiting = self._waiting[-(len(_HEADER) - 1) :]
            return None
        self._waiting = self._waiting[start:]
        if len(self._waiting) < _FRONT:
            return None
        length = int.from_bytes(self._waiting[5:7], "little")
        if not 3 <= length <= _LONGEST:
            self._waiting = self._waiting[len(_HEADER) :]
            return self._next()
        if len(self._waiting) < _FRONT + length:
            return None
        whole, self._waiting = self._waiting[: _FRONT + length], self._waiting[_FRONT + length :]
        body = whole[_FRONT:-2].replace(_STUFFED, _PLAIN)
        is_right = crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little")
        return Packet(whole[4], body[0] if is_right else None, body[1:])
