"""A fake keyboard: a pseudo terminal, typed into by a script."""

from __future__ import annotations

import time
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.keyboard.typist import FakeTerminal, TypistStep
from adapters.devices.fakes.script import Clock


def install(file: Path, clock: Clock = time.monotonic) -> FakeTerminal:
    """Return a terminal whose typist plays a script.

    Raises:
        BadFile: the script cannot be read.
    """
    return FakeTerminal(script.load(file, "keyboard", TypistStep), clock)
