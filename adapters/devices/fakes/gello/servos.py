"""A chain of fake servos, Dynamixel's or Feetech's: what each answers to a packet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

from adapters.devices.fakes.gello import feetech, protocol
from adapters.devices.fakes.gello.protocol import Packet
from adapters.devices.gello.bus import Servos

XL330_M288, STS3215 = 1200, 777

_TABLE_BYTES = 256
_FIRMWARE_VERSION = 52


class Servo:
    """One servo of Dynamixel: a table of bytes, of which the present position follows a function.

    Args:
        id_: Its number on the bus.
        position: Returns its present position, 4096 per turn.
        model: Its model number; None for that of leaders.

    Attributes:
        maker: Whose it is.
        is_silent: It answers nothing, as with its cable out.
        broken_answers: How many of its next answers come with a wrong CRC.
    """

    maker: ClassVar[Servos] = "dynamixel"
    usual_model: ClassVar[int] = XL330_M288
    wire: ClassVar[type[protocol.Wire | feetech.Wire]] = protocol.Wire

    _MODEL, _FIRMWARE, _ID, _TORQUE_ENABLE, _POSITION, _EEPROM_END = 0, 6, 7, 64, 132, 64

    def __init__(self, id_: int, position: Callable[[], int], model: int | None = None) -> None:
        self.id, self.is_silent, self.broken_answers = id_, False, 0
        self._position = position
        self._table = bytearray(_TABLE_BYTES)
        number = self.usual_model if model is None else model
        self._table[self._MODEL : self._MODEL + 2] = number.to_bytes(2, "little")
        self._table[self._FIRMWARE], self._table[self._ID] = _FIRMWARE_VERSION, id_

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes of the table; None beyond its end."""
        if address + length > _TABLE_BYTES:
            return None
        shown = self._shown(self._position())
        self._table[self._POSITION : self._POSITION + len(shown)] = shown
        return bytes(self._table[address : address + length])

    def write(self, address: int, data: bytes) -> int:
        """Write bytes of the table; return the error number."""
        if address + len(data) > _TABLE_BYTES:
            return protocol.BAD_LENGTH
        if address < self._EEPROM_END and self._table[self._TORQUE_ENABLE]:
            return protocol.NO_ACCESS
        self._table[address : address + len(data)] = data
        return protocol.NO_ERROR

    def answer(self, error: int, data: bytes = b"") -> bytes:
        """Return a status packet, or nothing from a silent servo."""
        if self.is_silent:
            return b""
        sent = self._status(error, data)
        if self.broken_answers:
            self.broken_answers -= 1
            return sent[:-1] + bytes([sent[-1] ^ 0xFF])
        return sent

    def identity(self) -> bytes:
        """Return what a ping is answered with: model number and firmware."""
        return bytes(self._table[self._MODEL : self._MODEL + 2]) + bytes([self._table[self._FIRMWARE]])

    def _shown(self, ticks: int) -> bytes:
        return ticks.to_bytes(4, "little", signed=True)

    def _status(self, error: int, data: bytes) -> bytes:
        return protocol.status(self.id, error, data)


class FeetechServo(Servo):
    """One STS3215: other places in the table, and a position of 15 bits whose 16th is its sign.

    It shows what it is given; whoever gives it begins anew after a turn, as a real one does (`wrapped`).
    """

    maker = "feetech"
    usual_model = STS3215
    wire = feetech.Wire

    _MODEL, _FIRMWARE, _ID, _TORQUE_ENABLE, _POSITION, _EEPROM_END = 3, 0, 5, 40, 56, 40

    def identity(self) -> bytes:
        """Return what a ping is answered with: nothing beside the error."""
        return b""

    def _shown(self, ticks: int) -> bytes:
        return (abs(ticks) | (1 << 15 if ticks < 0 else 0)).to_bytes(2, "little")

    def _status(self, error: int, data: bytes) -> bytes:
        return feetech.status(self.id, error, data) if error == protocol.NO_ERROR else b""  # it ignores what it cannot


SERVOS: dict[Servos, type[Servo]] = {"dynamixel": Servo, "feetech": FeetechServo}


def wrapped(ticks: int) -> int:
    """Return what an STS3215 shows: it begins anew after a turn."""
    return ticks % 4096


class Chain:
    """Servos on one bus, in the order of the cable.

    Args:
        servos: They, all of one maker.

    Attributes:
        maker: Whose they are.
        wire: Finds packets for them.
    """

    def __init__(self, servos: Sequence[Servo]) -> None:
        self.servos = {servo.id: servo for servo in servos}
        self.maker, self.wire = servos[0].maker, servos[0].wire

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
