"""What `station devices` knows of GELLO leader arms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from station.operator.device import DeviceKind

if TYPE_CHECKING:
    import click


def _plugged_in() -> Sequence[str]:
    from adapters.devices.gello import ports

    return ports.plugged_in()


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes.gello.run import run

    run(file)


def _calibrate() -> click.Command:
    from adapters.devices.gello.verb import command

    return command


KIND = DeviceKind(
    name="gello",
    about="one or two leader arms: joints and grippers",
    library="dynamixel-sdk",
    extra="gello",
    example=Path(__file__).parents[1] / "fakes/gello/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=("button_*",),
    calibrate=_calibrate,
)
