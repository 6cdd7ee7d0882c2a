"""A chain of fake Dynamixel servos: what each answers to a packet."""

from __future__ import annotations

from collections.abc import Callable

from adapters.devices.fakes.gello import protocol
from adapters.devices.fakes.gello.protocol import Packet

XL330_M288 = 1200

_TABLE_BYTES = 256
_MODEL, _FIRMWARE, _ID, _TORQUE_ENABLE, _POSITION = 0, 6, 7, 64, 132
_EEPROM_END = 64
_FIRMWARE_VERSION = 52


class Servo:
    """One servo: a table of bytes, of which the present position follows a function.

    Args:
        id_: Its number on the bus.
        position: Returns its present position, 4096 per turn.
        model: Its model number.

    Attributes:
        is_silent: It answers nothing, as with its cable out.
        broken_answers: How many of its next answers come with a wrong CRC.
    """

    def __init__(self, id_: int, position: Callable[[], int], model: int = XL330_M288) -> None:
        self.id, self.is_silent, self.broken_answers = id_, False, 0
        self._position = position
        self._table = bytearray(_TABLE_BYTES)
        self._table[_MODEL : _MODEL + 2] = model.to_bytes(2, "little")
        self._table[_FIRMWARE], self._table[_ID] = _FIRMWARE_VERSION, id_

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes of the table; None beyond its end."""
        if address + length > _TABLE_BYTES:
            return None
        self._table[_POSITION : _POSITION + 4] = self._position().to_bytes(4, "little", signed=True)
        return bytes(self._table[address : address + length])

    def write(self, address: int, data: bytes) -> int:
        """Write bytes of the table; return the error number."""
        if address + len(data) > _TABLE_BYTES:
            return protocol.BAD_LENGTH
        if address < _EEPROM_END and self._table[_TORQUE_ENABLE]:
            return protocol.NO_ACCESS
        self._table[address : address + len(data)] = data
        return protocol.NO_ERROR

    def answer(self, error: int, data: bytes = b"") -> bytes:
        """Return a status packet, or nothing from a silent servo."""
        if self.is_silent:
            return b""
        sent = protocol.status(self.id, error, data)
        if self.broken_answers:
            self.broken_answers -= 1
            return sent[:-1] + bytes([sent[-1] ^ 0xFF])
        return sent

    def identity(self) -> bytes:
        """Return what a ping is answered with: model number and firmware."""
        return bytes(self._table[_MODEL : _MODEL + 2]) + bytes([self._table[_FIRMWARE]])


class Chain:
    """Servos on one bus, in the order of the cable.

    Args:
        servos: They.
    """

    def __init__(self, servos: list[Servo]) -> None:
        self.servos = {servo.id: servo for servo in servos}

    def reply(self, packet: Packet) -> bytes:
        """Return what the bus answers to an instruction."""
        if packet.instruction == protocol.SYNC_READ:
            return self._sync_read(packet.parameters)
        if packet.instruction == protocol.SYNC_WRITE:
            return self._sync_write(packet.parameters)
        if packet.id == protocol.BROADCAST:
            asked = sorted(self.servos.values(), key=lambda servo: servo.id)
            return b"".join(servo.answer(protocol.NO_ERROR, servo.identity()) for servo in asked
                            if packet.instruction == protocol.PING)  # fmt: skip
        servo = self.servos.get(packet.id)
        return self._one(servo, packet) if servo is not None else b""

    @staticmethod
    def _one(servo: Servo, packet: Packet) -> bytes:
        if packet.instruction is None:
            return servo.answer(protocol.BAD_CRC)
        if packet.instruction == protocol.PING:
            return servo.answer(protocol.NO_ERROR, servo.identity())
        if packet.instruction == protocol.REBOOT:
            return servo.answer(protocol.NO_ERROR)
        if packet.instruction == protocol.READ and len(packet.parameters) == 4:
            data = servo.read(*_two_numbers(packet.parameters))
            return servo.answer(protocol.BAD_LENGTH) if data is None else servo.answer(protocol.NO_ERROR, data)
        if packet.instruction == protocol.WRITE and len(packet.parameters) > 2:
            return servo.answer(servo.write(int.from_bytes(packet.parameters[:2], "little"), packet.parameters[2:]))
        return servo.answer(protocol.BAD_INSTRUCTION)

    def _sync_read(self, parameters: bytes) -> bytes:
        """Answer in the order of the ids, each after the one before: behind a silent servo nobody speaks."""
        sent = b""
        for id_ in parameters[4:]:
            servo = self.servos.get(id_)
            data = servo.read(*_two_numbers(parameters[:4])) if servo is not None else None
            if servo is None or servo.is_silent or data is None:
                break
            sent += servo.answer(protocol.NO_ERROR, data)
        return sent

    def _sync_write(self, parameters: bytes) -> bytes:
        address, length = _two_numbers(parameters[:4])
        for start in range(4, len(parameters) - length, length + 1):
            servo = self.servos.get(parameters[start])
            if servo is not None:
                servo.write(address, parameters[start + 1 : start + 1 + length])
        return b""  # a sync write is never answered


def _two_numbers(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
