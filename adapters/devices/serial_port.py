"""What every device on a serial port shares: the number that its adapter bears, and why a port cannot be used."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path

BY_ID = Path("/dev/serial/by-id")

_SERIAL = re.compile(r"_([A-Za-z0-9-]+)-if\d+(-port\d+)?$")


def serial_of(port: str, folder: Path = BY_ID) -> str:
    """Return the serial number of a port's adapter: from its name, or from the name by id of the same device.

    For an adapter without one it is the last part of the port's name: ``ttyUSB0``.
    """
    names = [
        port,
        *(str(path) for path in sorted(folder.glob("*")) if os.path.realpath(path) == os.path.realpath(port)),
    ]
    for name in names:
        match = _SERIAL.search(os.path.basename(name))
        if match:
            return match[1]
    return os.path.basename(port)


def why_not_open(port: str, error: OSError, *, device: str, setting: str) -> str:
    """Return in one line why a port cannot be opened, and what to do.

    Args:
        port: Its name.
        error: What opening it raised.
        device: What is to be plugged in, as a person says it.
        setting: The setting that names another port.
    """
    number = error.errno
    if number == errno.ENOENT:
        return f"{port}: no such port; plug the {device} in, or name another with {setting}:"
    if number in (errno.EACCES, errno.EPERM):
        return f"{port}: permission denied; join the group of the port and log in anew: sudo usermod -aG dialout $USER"
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return f"{port}: in use by another process; stop it first (`fuser {os.path.realpath(port)}` tells which)"
    return f"{port}: cannot be opened: {error}"


def why_gone(port: str, error: Exception, *, device: str) -> str:
    """Return in one line that a port was torn out, as the error of a read or a write says."""
    said = str(error.args[-1] if error.args else error).splitlines()[0]
    return f"{port}: gone ({said}); plug the {device} in again"
