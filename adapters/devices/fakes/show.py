"""Showing what an adapter makes of a fake's script, without a bus."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click

from station.errors import StationError
from station.operator.device import Device, DeviceError
from station.operator.reading import Reading

_PERIOD_S = 0.02
_USAGE = 2


def run(module: str, open_device: Callable[[Path], Device]) -> None:
    """Open the device of the script that the command line names and print each change until Ctrl-C."""
    if len(sys.argv) != 2:
        click.echo(f"usage: python -m {module} FILE", err=True)
        raise SystemExit(_USAGE)
    try:
        show(open_device(Path(sys.argv[1])))
    except StationError as error:
        click.echo(f"station: {error}", err=True)
        raise SystemExit(error.exit_code) from None
    except KeyboardInterrupt:
        return
    except BrokenPipeError:  # `| head` has seen enough; nor is there anybody to tell at the end of the process
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def play(device: str, file: Path, open_device: Callable[[Path], Device]) -> None:
    """Play a script for `station devices fake`: such a fake is seen by the process that plays it alone.

    Raises:
        BadFile: the script cannot be read.
        DeviceError: the device cannot be opened.
    """
    opened = open_device(file)
    click.echo(f"what a station makes of it; a {device} server plays it with --set {device}.fake={file}", err=True)
    show(opened)


def show(device: Device) -> None:
    """Print a device's readings as they change; ends with the device."""
    began_s, last = time.monotonic(), ""
    try:
        while True:
            reading = device.read()
            line = _line(reading) if reading is not None else last
            if line != last:
                click.echo(f"{time.monotonic() - began_s:8.2f} s  {line}")
                last = line
            time.sleep(_PERIOD_S)
    except DeviceError as error:
        click.echo(f"{time.monotonic() - began_s:8.2f} s  {error}")
    finally:
        device.close()


def _line(reading: Reading) -> str:
    parts = [f"{name}={value:.3g}" for name, value in reading.controls.items() if value]
    for name, vector in (("twist", reading.twist), ("joints", reading.joints)):
        if vector is not None:
            parts.append(f"{name}=" + " ".join(f"{number:+.2f}" for number in vector))
    return "  ".join(parts) or "at rest"
