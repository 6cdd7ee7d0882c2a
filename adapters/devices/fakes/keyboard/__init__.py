"""A fake keyboard: a pseudo terminal, typed into by a script.

``python -m adapters.devices.fakes.keyboard FILE`` shows what the adapter makes of a script.
"""

from __future__ import annotations

import time
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.keyboard.typist import FakeTerminal, TypistStep
from adapters.devices.fakes.script import Clock
from adapters.devices.keyboard.device import Keyboard


def install(file: Path, clock: Clock = time.monotonic) -> FakeTerminal:
    """Return a terminal whose typist plays a script.

    Raises:
        BadFile: the script cannot be read.
    """
    return FakeTerminal(script.load(file, "keyboard", TypistStep), clock)


def opened(file: Path) -> Keyboard:
    """Return the adapter of a fake whose script begins now.

    Raises:
        BadFile: the script cannot be read.
        DeviceError: it cannot be opened.
    """
    terminal = install(file)
    device = Keyboard(tty=str(terminal.path))
    terminal.begin()
    return device
