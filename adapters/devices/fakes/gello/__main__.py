"""``python -m adapters.devices.fakes.gello FILE``: play a script on ports for a server that is started elsewhere."""

from __future__ import annotations

import contextlib
import signal
import sys
from pathlib import Path

import click

from adapters.devices.fakes.gello.run import run
from station.errors import StationError

if __name__ == "__main__":
    if len(sys.argv) != 2:
        click.echo("usage: python -m adapters.devices.fakes.gello FILE", err=True)
        raise SystemExit(2)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            run(Path(sys.argv[1]))
    except StationError as error:
        click.echo(f"station: {error}", err=True)
        raise SystemExit(error.exit_code) from None
