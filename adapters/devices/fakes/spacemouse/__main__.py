"""``python -m adapters.devices.fakes.spacemouse FILE``: show what the adapter makes of a script."""

from __future__ import annotations

from pathlib import Path

from adapters.devices.fakes import show
from adapters.devices.fakes.spacemouse import install
from adapters.devices.spacemouse.device import Spacemouse


def _open(file: Path) -> Spacemouse:
    install(file)
    return Spacemouse()


if __name__ == "__main__":
    show.run("adapters.devices.fakes.spacemouse", _open)
