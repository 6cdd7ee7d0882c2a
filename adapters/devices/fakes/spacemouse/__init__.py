"""A fake spacemouse under the real hidapi library: HID reports from a script."""

from __future__ import annotations

import time
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.script import Clock
from adapters.devices.fakes.spacemouse.hidapi import FakeHidapi
from adapters.devices.fakes.spacemouse.mouse import FakeMouse, MouseStep
from adapters.devices.spacemouse.find import library


def install(file: Path, clock: Clock = time.monotonic, *, start_s: float = 0.0) -> FakeHidapi:
    """Let this process see one spacemouse, which plays a script, and no other HID device.

    Args:
        file: The script.
        clock: Tells the time [s].
        start_s: Time of the script to begin at, with the first look [s].

    Raises:
        BadFile: the script cannot be read.
        DeviceError: there is no hidapi, or this system is no 64-bit Linux.
    """
    fake = FakeHidapi([FakeMouse(script.load(file, "spacemouse", MouseStep), clock, start_s=start_s)])
    fake.install(library())
    return fake
