"""What `station devices` knows of keyboards."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from station.operator.device import DeviceKind


def _plugged_in() -> Sequence[str]:
    return ["any terminal"]


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes import keyboard, show

    show.play("keyboard", file, keyboard.opened)


KIND = DeviceKind(
    name="keyboard",
    about="keys of a terminal: discrete commands, short jogs",
    library="",
    extra="",
    example=Path(__file__).parents[1] / "fakes/keyboard/example.json",
    plugged_in=_plugged_in,
    play=_play,
)
