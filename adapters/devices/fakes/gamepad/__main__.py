"""``python -m adapters.devices.fakes.gamepad FILE``: show what the adapter makes of a script."""

from __future__ import annotations

from adapters.devices.fakes import show
from adapters.devices.fakes.gamepad import opened

if __name__ == "__main__":
    show.run("adapters.devices.fakes.gamepad", opened)
