"""``python -m adapters.devices.fakes.keyboard FILE``: show what the adapter makes of a script."""

from __future__ import annotations

from pathlib import Path

from adapters.devices.fakes import show
from adapters.devices.fakes.keyboard import install
from adapters.devices.keyboard.device import Keyboard


def _open(file: Path) -> Keyboard:
    terminal = install(file)
    device = Keyboard(tty=str(terminal.path))
    terminal.begin()
    return device


if __name__ == "__main__":
    show.run("adapters.devices.fakes.keyboard", _open)
