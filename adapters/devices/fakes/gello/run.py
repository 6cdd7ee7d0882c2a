"""Fake leaders in the foreground, for a server or a calibration that is started elsewhere."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from adapters.devices.fakes.gello import FakeGello


def run(file: Path) -> None:
    """Print the settings with which a server finds the leaders of a script, and play it until Ctrl-C.

    Raises:
        BadFile: the script cannot be read.
    """
    fake = FakeGello(file)
    try:
        ports = ", ".join(str(leader.port.path) for leader in fake.leaders)
        click.echo(f"--set gello.ports='[{ports}]' --set gello.leaders={len(fake.leaders)} "
                   f"--set gello.servos={fake.servos} --set gello.calibrations={fake.calibrations}")  # fmt: skip
        click.echo("these settings let a gello server find the fake; Ctrl-C takes it away", err=True)
        fake.begin()
        threading.Event().wait()
    finally:
        fake.close()
