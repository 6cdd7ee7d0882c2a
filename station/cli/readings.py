"""What a device makes of the script of its fake, without a bus."""

from __future__ import annotations

import time
from pathlib import Path

import click

from station import config
from station.clock import SYSTEM
from station.operator.device import Device, DeviceError
from station.operator.device_kind import DeviceKind
from station.operator.sample import OperatorSample

_PERIOD_S = 0.02


def play(kind: DeviceKind, file: Path) -> None:
    """Play a script and print the device's readings as they change, until Ctrl-C or the end of the device.

    Raises:
        BadFile: the script cannot be read.
        DeviceError: the device cannot be opened.
    """
    settings = config.build(kind.config, {"fake": str(file)}, where=f"devices fake {kind.name}")
    with kind.source(settings, SYSTEM, 0.0) as source:
        device = source.open()
        click.echo(
            f"what a station makes of it; `station up` plays it with --set {kind.name}.fake={file}, "
            f"`station serve {kind.name}` with --set fake={file}",
            err=True,
        )
        if source.begin is not None:
            source.begin()
        _show(device)


def _show(device: Device) -> None:
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


def _line(reading: OperatorSample) -> str:
    parts = [f"{name}={value:.3g}" for name, value in reading.controls.items() if value]
    for name, vector in (("twist", reading.twist), ("joints", reading.joints)):
        if vector is not None:
            parts.append(f"{name}=" + " ".join(f"{number:+.2f}" for number in vector))
    return "  ".join(parts) or "at rest"
