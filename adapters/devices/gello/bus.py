"""A bus of Dynamixel servos through the maker's own library, with errors that say what to do."""

from __future__ import annotations

import errno
import importlib
import math
import os
import select
import termios
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.protocols import Floats

BAUDS = (57600, 1_000_000, 115_200, 2_000_000, 3_000_000, 4_000_000)
"""The rates of GELLO's makers, the most usual first."""

MODELS = {
    1020: "XM430-W350", 1060: "XL430-W250", 1190: "XL330-M077", 1200: "XL330-M288", 1220: "XC330-T288",
}  # fmt: skip

RAD_PER_TICK = math.pi / 2048.0

_PROTOCOL = 2.0
_PRESENT_POSITION, _POSITION_BYTES = 132, 4
_SIGN_BIT, _RANGE = 1 << 31, 1 << 32
_NAP_S = 0.002


class PortGone(DeviceError):
    """The serial port was torn out."""


def sdk() -> Any:
    """Return the module of the package ``dynamixel-sdk``.

    Raises:
        DeviceError: it is not installed.
    """
    try:
        return importlib.import_module("dynamixel_sdk")
    except ImportError:
        raise DeviceError(
            "a GELLO needs dynamixel-sdk, which is not installed; pip install 'teleop-station[gello]'"
        ) from None


def model_name(number: int) -> str:
    """Return what a model number stands for."""
    return MODELS.get(number, f"model {number}")


class MotorBus:
    """An open serial port with servos that speak protocol 2.0.

    Not for several threads at once.

    Args:
        port: Its name, best one of ``/dev/serial/by-id``.
        baud: Its rate [bit/s].
        clock: Of the process; the library's time-outs are by it.

    Raises:
        DeviceError: no such port, no permission, in use by another process, a rate that the library does not know, or
            no library.
    """

    def __init__(self, port: str, baud: int, clock: Clock = SYSTEM) -> None:
        self.port, self.baud, self.clock = port, baud, clock
        self._sdk = sdk()
        self._handler = self._open(port, baud)
        self._packets = self._sdk.PacketHandler(_PROTOCOL)
        self._reader: Any = None
        self._reader_ids: tuple[int, ...] = ()

    def ping(self, ids: Iterable[int], attempts: int = 8) -> dict[int, int]:
        """Return the model numbers of those servos that answer one of some pings; 35 ms for each that is not answered.

        Raises:
            PortGone: the port was torn out.
        """
        found = {}
        for id_ in ids:
            for _ in range(attempts):
                model, result, _ = self._guarded(self._packets.ping, self._handler, id_)
                if result == self._sdk.COMM_SUCCESS:
                    found[id_] = model
                    break
        return found

    def scan(self) -> dict[int, int]:
        """Return the model numbers of all servos that answer, by id; takes 1 to 2 s.

        Raises:
            PortGone: the port was torn out.
        """
        found, _ = self._guarded(self._packets.broadcastPing, self._handler)
        return {id_: facts[0] for id_, facts in sorted(found.items())}

    def positions(self, ids: Sequence[int]) -> Floats | None:
        """Return the present positions [rad], shape (len(ids),), 2048 ticks to half a turn; None when one is silent.

        Raises:
            PortGone: the port was torn out.
        """
        if self._reader_ids != tuple(ids):
            self._reader = self._sdk.GroupSyncRead(self._handler, self._packets, _PRESENT_POSITION, _POSITION_BYTES)
            for id_ in ids:
                self._reader.addParam(id_)
            self._reader_ids = tuple(ids)
        if self._guarded(self._reader.txRxPacket) != self._sdk.COMM_SUCCESS:
            return None
        raw = [self._reader.getData(id_, _PRESENT_POSITION, _POSITION_BYTES) for id_ in ids]
        # The library gives them unsigned; half a turn back from zero is no four thousand million ticks ahead.
        ticks = [value - _RANGE if value & _SIGN_BIT else value for value in raw]
        return np.array(ticks, dtype=np.float64) * RAD_PER_TICK

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        if self._handler.is_open:
            self._handler.closePort()

    def _guarded(self, call: Any, *arguments: Any) -> Any:
        """Call the library; it lets through whatever its serial port raises, and then never speaks again."""
        try:
            return call(*arguments)
        except (OSError, termios.error, TypeError, ValueError) as error:  # pyserial's own errors are OSErrors
            self._handler.is_using = False
            raise PortGone(f"{self.port}: gone ({_plain(error)}); plug the leader in again") from None

    def _open(self, port: str, baud: int) -> Any:
        handler = _patient(self._sdk, self.clock)(port)
        try:
            is_open = handler.setBaudRate(baud)
            if is_open:
                handler.ser.exclusive = True  # two that read one port would tear each other's packets
        except OSError as error:
            raise DeviceError(_why_not_open(port, error)) from None
        if not is_open:
            raise DeviceError(f"{port}: no such baud rate: {baud}; GELLO's servos use {', '.join(map(str, BAUDS))}")
        return handler


def _patient(sdk_: Any, clock: Clock) -> Any:
    """Return the library's port, but one that sleeps until bytes come where the original spins; and whose time-outs are
    no matter of the wall clock, which may be set."""

    class PatientPort(sdk_.PortHandler):  # type: ignore[misc]
        def readPort(self, length: int) -> Any:  # noqa: N802
            if length > 0 and self.ser.in_waiting == 0:
                select.select([self.ser.fileno()], [], [], _NAP_S)
            return super().readPort(length)

        def getCurrentTime(self) -> float:  # noqa: N802  milliseconds
            return clock.monotonic_ns() * 1e-6

    return PatientPort


def _plain(error: Exception) -> str:
    return str(error.args[-1] if error.args else error).splitlines()[0]


def _why_not_open(port: str, error: OSError) -> str:
    number = error.errno
    if number == errno.ENOENT:
        return f"{port}: no such port; plug the leader in, or name another with ports:"
    if number in (errno.EACCES, errno.EPERM):
        return f"{port}: permission denied; join the group of the port and log in anew: sudo usermod -aG dialout $USER"
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return f"{port}: in use by another process; stop it first (`fuser {os.path.realpath(port)}` tells which)"
    return f"{port}: cannot be opened: {error}"
