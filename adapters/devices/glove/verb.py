"""``station devices calibrate glove``: calibrating a sensor glove at a terminal."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from adapters.devices.console import Terminal
from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove import ports
from adapters.devices.glove.calibrate import Plan, calibrate_port
from adapters.devices.glove.calibration import Side
from adapters.devices.glove.lines import Protocol
from adapters.devices.glove.ports import BAUD
from adapters.devices.glove.sensors import UNUSED, why_not
from adapters.devices.serial_port import serial_of
from station.errors import UsageError


@click.command("glove")
@click.option("--side", required=True, type=click.Choice(["left", "right"]), help="The hand that wears it.")
@click.option("--port", default="", help="Serial port of the glove.  [default: the only adapter that is plugged in]")
@click.option(
    "--protocol", default="numbers", show_default=True, type=click.Choice(["numbers", "opengloves"]),
    help="How it writes: numbers with spaces or commas between, or letters as OpenGloves has them.",
)  # fmt: skip
@click.option(
    "--sensors", metavar="NAMES", default=None,
    help="A name for each number of its line: thumb,index_0,-,…; - is none.  [default: by how many there are, 5 or 15]",
)  # fmt: skip
@click.option("--baud", default=BAUD, show_default=True, help="Rate of the port [bit/s].")
@click.option(
    "--calibrations", metavar="DIR", default=None, type=click.Path(file_okay=False, path_type=Path),
    help="Folder to keep it in.  [default: ~/.config/station/glove]",
)  # fmt: skip
def command(
    side: Side, port: str, protocol: Protocol, sensors: str | None, baud: int, calibrations: Path | None
) -> None:
    """Find what the sensors of a glove show for a flat hand and for a fist; keep it by serial number and side.

    You are asked to hold the hand flat, and then to make a fist. Nothing is kept before the end.
    """
    plan = Plan(side, protocol, () if sensors is None else _names(sensors))
    chosen = port or ports.only_adapter()
    if not sys.stdin.isatty():
        raise UsageError("devices calibrate glove: there is no terminal to ask in; it needs somebody with the glove on")
    terminal = Terminal()
    _print_replaced(chosen, side, calibrations, terminal)
    calibrate_port(chosen, plan, terminal, baud=baud, folder=calibrations)


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if why := why_not([name for name in names if name != UNUSED]):
        raise UsageError(f"--sensors: {why}")
    return names


def _print_replaced(port: str, side: Side, folder: Path | None, terminal: Terminal) -> None:
    file = calibrations.file_of(folder or calibrations.default_folder(), serial_of(port), side)
    if file.exists():
        terminal.show(f"{file} is there and will be replaced at the end")
