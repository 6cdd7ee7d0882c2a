"""``python -m adapters.devices.fakes.gamepad FILE``: show what the adapter makes of a script."""

from __future__ import annotations

from pathlib import Path

from adapters.devices.fakes import show
from adapters.devices.fakes.gamepad import install
from adapters.devices.fakes.gamepad.pad import NAME
from adapters.devices.gamepad.device import Gamepad


def _open(file: Path) -> Gamepad:
    pad = install(file)
    device = Gamepad(name=NAME)
    pad.begin()
    return device


if __name__ == "__main__":
    show.run("adapters.devices.fakes.gamepad", _open)
