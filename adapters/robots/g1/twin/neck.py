"""The neck of a robot twin: two Dynamixel servos behind a pseudo terminal, as TWIST2's robot has them."""

from __future__ import annotations

import termios
import time
from pathlib import Path
from typing import Any

from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import Chain, Servo
from adapters.devices.gello.bus import RAD_PER_TICK

SERIAL = "TWIN-NECK"
"""Number of the adapter: the port's name in its folder is as udev gives it."""

_STRAIGHT, _TICKS_S = 2048, round(5.0 / RAD_PER_TICK)
_GOAL, _TORQUE = 116, 64


class NeckServo(Servo):
    """A servo that goes to its goal while it has torque, and stays where it is without.

    Args:
        id_: Its number.
    """

    def __init__(self, id_: int) -> None:
        super().__init__(id_, self._position_now)
        self.ticks, self._at_s = float(_STRAIGHT), time.monotonic()
        self._set_goal()

    @property
    def is_stiff(self) -> bool:
        """Whether it has torque."""
        return bool(self._table[_TORQUE])

    def write(self, address: int, data: bytes) -> int:
        """Write bytes of the table; as it gets torque its goal is where it is."""
        self._position_now()
        was_stiff = self.is_stiff
        error = super().write(address, data)
        if self.is_stiff and not was_stiff:
            self._set_goal()
        return error

    def _set_goal(self) -> None:
        self._table[_GOAL : _GOAL + 4] = round(self.ticks).to_bytes(4, "little", signed=True)

    def _position_now(self) -> int:
        now_s = time.monotonic()
        reach, self._at_s = (now_s - self._at_s) * _TICKS_S, now_s
        if self.is_stiff:
            goal = int.from_bytes(self._table[_GOAL : _GOAL + 4], "little", signed=True)
            self.ticks += min(max(goal - self.ticks, -reach), reach)
        return round(self.ticks)


class TwinNeck:
    """Yaw is servo 0, pitch servo 1, at 2 Mbit/s.

    Args:
        folder: Where its port appears.
    """

    def __init__(self, folder: Path) -> None:
        self.servos = [NeckServo(0), NeckServo(1)]
        folder.mkdir(parents=True, exist_ok=True)
        self.port = FakePort(folder, SERIAL, Chain(self.servos), baud=termios.B2000000)

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        return {"ticks": [round(each.ticks) for each in self.servos], "is_stiff": [e.is_stiff for e in self.servos]}

    def close(self) -> None:
        """Take the port away."""
        self.port.close()
