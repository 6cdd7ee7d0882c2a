"""Unitree's LowState and LowCmd as arrays: each field a view on the bytes of the message, and their checksum.

A message on the wire is four bytes of header and a body in CDR, little endian. CDR does not pad nested structs, and the
checksum is made over the C struct, which does: its padding is put back for it. The octet ``mode`` of a motor stands
before the padding of its floats, so that of motor 0 is alone, and the others are in the record of the motor before.

Source: ``include/unitree/idl/hg`` and ``crc.h`` of unitreerobotics/unitree_sdk2.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.errors import StationError

try:
    from fastcrc import crc32
except ImportError as error:  # whoever has the extra from before it was part of it
    raise StationError("a G1's wire needs fastcrc, which is not installed; pip install 'teleop-station[g1]'") from error

SLOTS = 35
"""Motors in a message; a robot has fewer."""

TIMED_OUT = 0x40000000
"""Bit of a motor's error word: it gets no commands."""

_BYTE = "u1"
_MOTOR_STATE = np.dtype({
    "names": ["q", "dq", "ddq", "tau", "motion", "temperature", "voltage", "sensor", "error", "reserve", "next_mode"],
    "formats": ["<f4", "<f4", "<f4", "<f4", ("<f4", 4), ("<i2", 2), "<f4", ("<u4", 2), "<u4", ("<u4", 4), _BYTE],
    "offsets": [0, 4, 8, 12, 0, 16, 20, 24, 32, 36, 52],
    "itemsize": 56,
})  # fmt: skip
STATE = np.dtype({
    "names": ["header", "version", "mode_pr", "mode_machine", "tick", "quat_wxyz", "gyro", "accelerometer", "inertial",
              "rpy", "imu_temperature", "first_mode", "motors", "remote", "reserve", "crc"],
    "formats": [(_BYTE, 4), ("<u4", 2), _BYTE, _BYTE, "<u4", ("<f4", 4), ("<f4", 3), ("<f4", 3), ("<f4", 10),
                ("<f4", 3), "<i2", _BYTE, (_MOTOR_STATE, SLOTS), (_BYTE, 40), ("<u4", 4), "<u4"],
    "offsets": [0, 4, 12, 13, 16, 20, 36, 48, 20, 60, 72, 74, 76, 2032, 2072, 2088],
    "itemsize": 2092,
})  # fmt: skip
"""A LowState as it is on the wire. ``tick`` [ms]; motors: q [rad], dq [rad/s], ddq [rad/s^2], tau [N m], those four at
once as ``motion``, temperature of casing and winding [°C], voltage [V], error bits; of the pelvis quat_wxyz, gyro
[rad/s], accelerometer [m/s^2], those three at once as ``inertial``, rpy [rad]."""

_MOTOR_CMD = np.dtype({
    "names": ["q", "dq", "tau", "kp", "kd", "reserve", "next_mode"],
    "formats": ["<f4", "<f4", "<f4", "<f4", "<f4", "<u4", _BYTE],
    "offsets": [0, 4, 8, 12, 16, 20, 24],
    "itemsize": 28,
})  # fmt: skip
CMD = np.dtype({
    "names": ["header", "mode_pr", "mode_machine", "first_mode", "motors", "reserve", "crc"],
    "formats": [(_BYTE, 4), _BYTE, _BYTE, _BYTE, (_MOTOR_CMD, SLOTS), ("<u4", 4), "<u4"],
    "offsets": [0, 4, 5, 6, 8, 984, 1000],
    "itemsize": 1004,
})  # fmt: skip
"""A LowCmd as it is on the wire: torque = tau + kp (q - q_measured) + kd (dq - dq_measured)."""

_BATTERY = struct.Struct("<88xI8xiBB12h38x")  # a BmsState: voltage, current, charge, health, temperatures
_HEADER = (0, 1, 0, 0)  # CDR of version 1, little endian


def states(messages: Sequence[bytes]) -> NDArray[Any]:
    """Return LowStates as records of `STATE`, shape (k,); those of another length or byte order are left out."""
    whole = [message for message in messages if len(message) == STATE.itemsize and message[:2] == b"\0\1"]
    return np.frombuffer(b"".join(whole), STATE)


def battery(message: bytes) -> tuple[float, float, float, float, float] | None:
    """Return charge [%], health [%], voltage of the pack [V], current [A] and highest temperature [°C] of a BmsState.

    None for a message of another length or byte order. By `struct`: for five numbers NumPy takes eight times as long.
    """
    if len(message) != _BATTERY.size or message[:2] != b"\0\1":
        return None
    millivolts, milliamperes, charge, health, *temperatures = _BATTERY.unpack(message)
    return charge, health, millivolts / 1000.0, milliamperes / 1000.0, max(temperatures)


def intact_states(messages: Sequence[bytes]) -> NDArray[Any]:
    """As `states`, without those whose checksum is wrong."""
    return states([message for message in messages if is_intact(message)])


def command(message: bytes) -> NDArray[Any] | None:
    """Return a LowCmd as one record of `CMD`, shape (1,); None for one of another length or byte order."""
    is_whole = len(message) == CMD.itemsize and message[:2] == b"\0\1"
    return np.frombuffer(message, CMD) if is_whole else None


def new_state() -> NDArray[Any]:
    """Return a LowState of zeros, shape (1,)."""
    return _new(STATE)


def new_command() -> NDArray[Any]:
    """Return a LowCmd of zeros, shape (1,): every motor disabled."""
    return _new(CMD)


def set_modes(record: NDArray[Any], modes: NDArray[np.uint8]) -> None:
    """Set the octet ``mode`` of the first motors of a record of either kind; shape (n,) with 1 for enabled."""
    record["first_mode"][0] = modes[0]
    record["motors"]["next_mode"][0, : len(modes) - 1] = modes[1:]


def modes(record: NDArray[Any], count: int) -> NDArray[np.uint8]:
    """Return the octets ``mode`` of the first motors of a record of either kind, shape (count,)."""
    return np.concatenate([record["first_mode"][:1], record["motors"]["next_mode"][0, : count - 1]])


def signed(record: NDArray[Any]) -> bytes:
    """Return a record of either kind as bytes for the wire, with its checksum."""
    body = record.tobytes()
    return body[:-4] + checksum(body).to_bytes(4, "little")


def checksum(message: bytes) -> int:
    """Return the checksum that belongs to a LowCmd or a LowState, header included, by its length."""
    body = message[4:-4]
    if len(message) == CMD.itemsize:
        padded = body[:2] + b"\0\0" + body[2:3] + b"\0\0\0" + body[4:]
    else:
        padded = body[:10] + b"\0\0" + body[12:70] + b"\0\0" + body[70:71] + b"\0\0\0" + body[72:]
    return crc32_of_words(padded)


def is_intact(message: bytes) -> bool:
    """Whether bytes are as long as a LowCmd or a LowState, header included, and their checksum is right."""
    is_whole = len(message) in (CMD.itemsize, STATE.itemsize)
    return is_whole and checksum(message) == int.from_bytes(message[-4:], "little")


def crc32_of_words(data: bytes) -> int:
    """Return the CRC-32 that Unitree makes of little-endian words, most significant bit first.

    Polynomial 0x04C11DB7, from 0xFFFFFFFF, neither reflected nor inverted at the end: CRC-32/MPEG-2, of each word its
    most significant byte first.
    """
    words = array("I", data)
    words.byteswap()
    return crc32.mpeg_2(words.tobytes())


def _new(kind: np.dtype[Any]) -> NDArray[Any]:
    record = np.zeros(1, kind)
    record["header"][0] = _HEADER
    return record
