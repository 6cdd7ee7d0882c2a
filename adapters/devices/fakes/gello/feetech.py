"""Feetech's protocol as an STS servo speaks it: instruction packets in, status packets out.

    FF FF, id, length, instruction, parameters, checksum

The length counts what follows it; the checksum is the inverted sum of all from the id on. Addresses and lengths among
the parameters are single bytes.
"""

from __future__ import annotations

from adapters.devices.fakes.gello import protocol
from adapters.devices.fakes.gello.protocol import Packet

_HEADER = b"\xff\xff"
_FRONT = 4  # header, id and length
_NUMBERS = {protocol.READ: 2, protocol.SYNC_READ: 2, protocol.WRITE: 1, protocol.SYNC_WRITE: 2}
"""How many of an instruction's parameters are an address or a length."""


def packet(id_: int, instruction: int, parameters: bytes) -> bytes:
    """Return a packet as it goes over the wire."""
    body = bytes([id_, len(parameters) + 2, instruction]) + parameters
    return _HEADER + body + bytes([~sum(body) & 0xFF])


def status(id_: int, error: int, data: bytes = b"") -> bytes:
    """Return the answer of a servo, which has its error where an instruction was."""
    return packet(id_, error, data)


class Wire:
    """Finds packets in the bytes that arrive; one with a wrong checksum is noise, as to a servo.

    Addresses and lengths are made two bytes wide, as those of protocol 2.0, so that one chain serves both.
    """

    def __init__(self) -> None:
        self._waiting = b""

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete by now; noise between them is dropped."""
        self._waiting += data
        found: list[Packet] = []
        while (start := self._waiting.find(_HEADER)) >= 0:
            self._waiting = self._waiting[start:]
            if len(self._waiting) < _FRONT:
                return found
            id_, length = self._waiting[2:_FRONT]
            if id_ == 0xFF or length < 2:  # a header begins one byte later, or none does
                self._waiting = self._waiting[1:]
                continue
            if len(self._waiting) < _FRONT + length:
                return found
            whole, rest = self._waiting[: _FRONT + length], self._waiting[_FRONT + length :]
            if packet(id_, whole[_FRONT], whole[_FRONT + 1 : -1]) != whole:
                self._waiting = self._waiting[1:]
                continue
            found.append(Packet(id_, whole[_FRONT], _widened(whole[_FRONT], whole[_FRONT + 1 : -1])))
            self._waiting = rest
        self._waiting = self._waiting[-1:]
        return found


def _widened(instruction: int, parameters: bytes) -> bytes:
    count = _NUMBERS.get(instruction, 0)
    return b"".join(bytes([number, 0]) for number in parameters[:count]) + parameters[count:]
