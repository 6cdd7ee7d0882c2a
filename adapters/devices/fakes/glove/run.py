"""Fake gloves in the foreground, for a server or a calibration that is started elsewhere."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from adapters.devices.fakes.glove import FakeGloves


def run(file: Path) -> None:
    """Print the settings with which a server finds each glove of a script, and play it until Ctrl-C.

    Raises:
        BadFile: the script cannot be read.
    """
    fake = FakeGloves(file)
    try:
        for glove in fake.gloves:
            click.echo(f"--set glove.side={glove.side} --set glove.port={glove.port.path} "
                       f"--set glove.calibrations={fake.calibrations}")  # fmt: skip
        click.echo("these settings let a glove server find the fake; Ctrl-C takes it away", err=True)
        fake.begin()
        threading.Event().wait()
    finally:
        fake.close()
