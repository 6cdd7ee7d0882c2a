"""Files of what was found by calibrating a device: YAML of one type, written whole or not at all."""

from __future__ import annotations

import datetime
import os
from pathlib import Path
from typing import TypeVar

import msgspec

from station.errors import BadFile
from station.operator.device import DeviceError

C = TypeVar("C", bound=msgspec.Struct)


def default_folder(device: str) -> Path:
    """Return where calibrations of a kind are kept, ``$XDG_CONFIG_HOME/station/<device>``; not necessarily there."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base).absolute() if base else Path.home() / ".config") / "station" / device


def read(path: Path, kind: type[C], *, of: str, missing: str) -> C:
    """Read a calibration.

    Args:
        path: Its file.
        kind: What it says.
        of: Whose it is: ``a leader``.
        missing: What is said when there is no such file.

    Raises:
        DeviceError: there is none.
        BadFile: it cannot be read, or says something else.
    """
    try:
        return msgspec.yaml.decode(path.read_bytes(), type=kind)
    except FileNotFoundError:
        raise DeviceError(missing) from None
    except OSError as error:
        raise BadFile(f"{path}: cannot be read: {error.strerror}; expected the calibration of {of}") from None
    except (msgspec.MsgspecError, ValueError) as error:
        raise BadFile(f"{path}: no calibration of {of}: {' '.join(str(error).split())[:200]}") from None


def write(path: Path, calibration: msgspec.Struct) -> Path:
    """Write a calibration; return its file.

    Raises:
        BadFile: it cannot be written.
    """
    temporary = path.with_name(f"{path.stem}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(msgspec.yaml.encode(calibration))
        os.replace(temporary, path)
    except OSError as error:
        raise BadFile(f"{path}: cannot be written: {error.strerror}") from None
    return path


def today() -> str:
    """Return the date that a calibration made now bears."""
    return datetime.date.today().isoformat()
