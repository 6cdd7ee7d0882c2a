"""A fake gamepad under the real pygame: a virtual pad of SDL, moved by a script."""

from __future__ import annotations

import time
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.gamepad.pad import FakePad, PadStep
from adapters.devices.fakes.script import Clock
from adapters.devices.gamepad import sdl


def install(file: Path, clock: Clock = time.monotonic) -> FakePad:
    """Plug a pad that plays a script into this process's SDL.

    Raises:
        BadFile: the script cannot be read.
        DeviceError: there is no pygame, or its SDL is not found.
    """
    steps = script.load(file, "gamepad", PadStep)
    sdl.start()
    return FakePad(steps, clock)
