"""``python -m adapters.devices.fakes.gello FILE``: play a script on ports for a server that is started elsewhere."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path

import click

from adapters.devices.fakes.gello import FakeGello
from station.errors import StationError

if __name__ == "__main__":
    if len(sys.argv) != 2:
        click.echo("usage: python -m adapters.devices.fakes.gello FILE", err=True)
        raise SystemExit(2)
    try:
        fake = FakeGello(Path(sys.argv[1]))
    except StationError as error:
        click.echo(f"station: {error}", err=True)
        raise SystemExit(error.exit_code) from None
    ports = ", ".join(str(leader.port.path) for leader in fake.leaders)
    click.echo(f"--set gello.ports='[{ports}]' --set gello.leaders={len(fake.leaders)} "
               f"--set gello.calibrations={fake.calibrations}")  # fmt: skip
    fake.begin()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        fake.close()
