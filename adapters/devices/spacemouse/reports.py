"""What a 3Dconnexion device sends: HID reports, little-endian.

    id 1, 7 bytes      translation x y z, int16 each
    id 2, 7 bytes      rotation rx ry rz
    id 1, 13 bytes     both, on the wireless, Enterprise and newer Pro models
    id 3               buttons, one bit each

The layout is read off the report and not looked up by model: a receiver does not say which mouse is paired with it.
The device's axes are x right, y towards the person, z down; ours are FLU (forward, left, up). That is a proper
rotation, so translation and rotation turn alike.
"""

from __future__ import annotations

import struct

import numpy as np

from station.protocols import Floats

FULL_DEFLECTION = 350.0
"""Raw value of a fully deflected cap; a strong hand reaches 500."""

_MOTION, _ROTATION, _BUTTONS = 1, 2, 3
_THREE, _SIX = struct.Struct("<xhhh"), struct.Struct("<xhhhhhh")

_FLU_FROM_DEVICE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


class Deflection:
    """What a spacemouse's reports add up to.

    Attributes:
        buttons: Bit field of the buttons that are pressed.
        pressed: And of those that were pressed since `pop_pressed`, be they let go by now.
        odd_reports: Reports that were too short for their id.
    """

    def __init__(self) -> None:
        self.buttons = 0
        self.pressed = 0
        self.odd_reports = 0
        self._raw = np.zeros(6)  # x y z rx ry rz in the device's axes

    @property
    def is_zero(self) -> bool:
        """Whether the cap is at rest."""
        return not self._raw.any()

    def update(self, report: bytes) -> bool:
        """Add one report; False for one that is neither of motion nor of buttons, such as the battery's."""
        kind = report[0] if report else 0
        if kind == _MOTION and len(report) >= _SIX.size:
            self._raw[:] = _SIX.unpack_from(report)
        elif kind in (_MOTION, _ROTATION) and len(report) >= _THREE.size:
            first = 0 if kind == _MOTION else 3
            self._raw[first : first + 3] = _THREE.unpack_from(report)
        elif kind == _BUTTONS and len(report) > 1:
            self.buttons = int.from_bytes(report[1:], "little")
            self.pressed |= self.buttons
        else:
            self.odd_reports += kind in (_MOTION, _ROTATION, _BUTTONS)
            return False
        return True

    def centre(self) -> None:
        """Forget the deflection: nobody can tell any more whether a hand is on the cap."""
        self._raw[:] = 0.0

    def release(self) -> None:
        """Forget deflection and buttons."""
        self.centre()
        self.buttons = self.pressed = 0

    def pop_pressed(self) -> int:
        """Return the bit field of the buttons that are or were pressed since the last call: a tap is never missed."""
        pressed, self.pressed = self.pressed | self.buttons, 0
        return pressed

    def twist(self) -> Floats:
        """Return vx vy vz wx wy wz in FLU, shape (6,), each -1..1 of full deflection."""
        halves = self._raw.reshape(2, 3) @ _FLU_FROM_DEVICE.T
        return np.asarray(np.clip(halves.ravel() / FULL_DEFLECTION, -1.0, 1.0) + 0.0)


def encode_motion(twist: Floats, *, in_one: bool) -> list[bytes]:
    """Return the reports a device sends for a twist in FLU: one of 13 bytes, or two of 7."""
    halves = np.asarray(twist, dtype=np.float64).reshape(2, 3) @ _FLU_FROM_DEVICE  # the inverse of a rotation
    raw = np.rint(halves * FULL_DEFLECTION).astype(int).ravel().tolist()
    if in_one:
        return [struct.pack("<B6h", _MOTION, *raw)]
    return [struct.pack("<B3h", _MOTION, *raw[:3]), struct.pack("<B3h", _ROTATION, *raw[3:])]


def encode_buttons(pressed: list[int]) -> bytes:
    """Return the report of the buttons (bits) that are pressed, 7 bytes as on the models with many."""
    return bytes([_BUTTONS]) + sum(1 << bit for bit in set(pressed)).to_bytes(6, "little")


def with_dead_band(twist: Floats, dead_band: float) -> Floats:
    """Return a twist that is zero up to the dead band and rises from zero beyond it to the same full deflection."""
    beyond = np.maximum(np.abs(twist) - dead_band, 0.0) / (1.0 - dead_band)
    return np.asarray(np.copysign(beyond, twist) + 0.0)
