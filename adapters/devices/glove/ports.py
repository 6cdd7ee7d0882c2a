"""Which serial port is the glove's, and the bytes that come from it."""

from __future__ import annotations

import importlib
import termios
from pathlib import Path
from typing import Any

from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove.calibration import Side
from adapters.devices.serial_port import BY_ID, PortGone, serial_of, why_gone, why_not_open
from station.operator.device import DeviceError

BAUD = 115_200

_ADAPTERS = "usb-*"
_A_LEADER = "usb-FTDI_USB__-__Serial_Converter_"  # what GELLO's U2D2 is called
_SIDES: tuple[Side, ...] = ("left", "right")
_WAIT_S = 0.02
_CHUNK = 4096


class GlovePort:
    """An open serial port of a glove, which no other process can open meanwhile.

    Not for several threads at once.

    Args:
        port: Its name, best one of ``/dev/serial/by-id``.
        baud: Its rate [bit/s].

    Raises:
        DeviceError: no such port, no permission, in use by another process, a rate that it does not have, or no
            library.
    """

    def __init__(self, port: str, baud: int) -> None:
        self.port, self.baud = port, baud
        try:
            self._line = _library().Serial(port, baudrate=baud, timeout=_WAIT_S, exclusive=True)
        except OSError as error:  # pyserial's own errors are
            raise DeviceError(why_not_open(port, error, device="glove", setting="port")) from None
        except (ValueError, termios.error) as error:
            raise DeviceError(f"{port}: cannot be opened at {baud} baud: {error}; set another baud:") from None

    def read(self) -> bytes:
        """Return what has come since the last call; waits for up to 20 ms when that is nothing.

        Raises:
            PortGone: the port was torn out.
        """
        try:
            return bytes(self._line.read(min(max(1, self._line.in_waiting), _CHUNK)))
        except (OSError, termios.error, TypeError, ValueError) as error:
            raise PortGone(why_gone(self.port, error, device="glove")) from None

    def drop(self) -> None:
        """Drop what has come and was not read.

        Raises:
            PortGone: the port was torn out.
        """
        try:
            self._line.reset_input_buffer()
        except (OSError, termios.error, TypeError, ValueError) as error:
            raise PortGone(why_gone(self.port, error, device="glove")) from None

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        self._line.close()


def _library() -> Any:
    try:
        return importlib.import_module("serial")
    except ImportError:
        raise DeviceError(
            "a glove needs pyserial, which is not installed; pip install 'teleop-station[glove]'"
        ) from None


def adapters(folder: Path = BY_ID) -> list[str]:
    """Return the names of the ports of all USB serial adapters that are plugged in."""
    return sorted(str(path) for path in folder.glob(_ADAPTERS))


def choose(side: Side, calibrations_folder: Path, folder: Path = BY_ID) -> str:
    """Return the port of the only adapter that has a calibration of a glove for a side.

    Args:
        side: The hand that wears it.
        calibrations_folder: Where calibrations are kept.
        folder: Where ports appear by serial number.

    Raises:
        DeviceError: there is none, or several.
    """
    every = adapters(folder)
    found = [port for port in every if _is_calibrated(port, side, calibrations_folder, folder)]
    if len(found) > 1:
        raise DeviceError(f"{len(found)} {side} gloves found: {', '.join(found)}; choose one with port:")
    if found:
        return found[0]
    if not every:
        raise DeviceError(f"no {side} glove found: no {_ADAPTERS} in {folder}; plug it in, or name its port with port:")
    raise DeviceError(
        f"no {side} glove found: none of {', '.join(every)} has a calibration in {calibrations_folder}; plug the glove "
        f"in, or calibrate it: station devices calibrate glove --side {side}"
    )


def only_adapter(folder: Path = BY_ID) -> str:
    """Return the port of the only adapter that is plugged in.

    Raises:
        DeviceError: there is none, or several.
    """
    found = adapters(folder)
    if not found:
        raise DeviceError(f"no {_ADAPTERS} in {folder}; plug the glove in, or name its port with --port")
    if len(found) > 1:
        raise DeviceError(f"{len(found)} adapters found: {', '.join(found)}; choose one with --port")
    return found[0]


def plugged_in(folder: Path = BY_ID) -> list[str]:
    """Return a line for each adapter that may belong to a glove: its serial number and its port."""
    kept, told = calibrations.default_folder(), []
    for port in adapters(folder):
        sides = [side for side in _SIDES if _is_calibrated(port, side, kept, folder)]
        if sides or not Path(port).name.startswith(_A_LEADER):
            known = f"calibrated as the {' and the '.join(sides)} glove" if sides else "not calibrated as a glove"
            told.append(f"adapter {serial_of(port, folder)} at {port}, {known}")
    return told


def _is_calibrated(port: str, side: Side, calibrations_folder: Path, folder: Path) -> bool:
    return calibrations.file_of(calibrations_folder, serial_of(port, folder), side).is_file()
