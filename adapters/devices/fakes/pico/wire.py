"""What XRoboToolkit's PC service says, byte for byte: its protobuf messages and the JSON inside them.

Only what a client library asks for is here, written by hand: five messages of strings need no generated code. Source:
XR-Robotics/XRoboToolkit-PC-Service, ``PXREAService.proto`` and ``PXREARobotSDK.cpp``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

SERVICE = "PXREAService.EAService"
EMPTY = b""
LONGEST_STATE = 16351  # bytes; the library cuts what is longer, and then drops the frame

Frame = Mapping[str, Any]
"""The inner JSON of one state: ``Head``, ``Controller``, ``Body``, …, in the headset's own frame."""

_NAME, _DEVICE, _STATE = 1, 3, 15  # fields of ServerFeedback
_LENGTH_DELIMITED = 2


def device_found(serial: str) -> bytes:
    """Return the message that a headset is there."""
    return _text(_NAME, "deviceFind") + _text(_DEVICE, serial)


def device_state(serial: str, frame: Frame) -> bytes:
    """Return the message that carries one frame; the frame is JSON text inside JSON."""
    value = json.dumps(frame, separators=(",", ":"))
    state = json.dumps({"functionName": "Tracking", "value": value}, separators=(",", ":"))
    return _text(_NAME, "deviceStateJson") + _field(_STATE, _text(1, serial) + _text(2, state))


def numbers(values: Sequence[float]) -> str:
    """Return numbers as the service writes a pose: decimals (micrometres) with commas between them."""
    return ",".join(f"{value:.6f}" for value in values)


def _text(field: int, text: str) -> bytes:
    return _field(field, text.encode())


def _field(number: int, content: bytes) -> bytes:
    return _varint(number << 3 | _LENGTH_DELIMITED) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    groups = []
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*groups, value])
